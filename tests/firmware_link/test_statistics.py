"""The counters of a link."""

from __future__ import annotations

from firmware_link.host import HostSession
from firmware_link.protocol import Codec, Vent
from firmware_link.statistics import LinkStatistics, Traffic


def read(traffic: Traffic, t: float, dropped_bytes: int = 0) -> LinkStatistics:
    return traffic.statistics(t, Codec(), HostSession(), dropped_bytes)


def test_rates_are_those_of_the_last_whole_second() -> None:
    traffic = Traffic()
    for tick in range(250):
        traffic.received(7.0 + tick / 100, b"x" * 32)
        traffic.written(7.0 + tick / 100, b"y" * 10)
    now = read(traffic, 9.49)
    assert (now.received_bytes_per_s, now.sent_bytes_per_s) == (3200, 1000)
    assert (now.received_bytes, now.sent_bytes) == (8000, 2500)
    assert read(traffic, 10.0).received_bytes_per_s == 1600
    assert read(traffic, 11.0).received_bytes_per_s == 0


def test_dropped_bytes_do_not_count_as_sent() -> None:
    traffic = Traffic()
    traffic.written(0.0, b"x" * 100)
    now = read(traffic, 0.0, dropped_bytes=30)
    assert (now.sent_bytes, now.dropped_bytes) == (70, 30)


def test_the_first_opening_is_no_reconnect() -> None:
    traffic = Traffic()
    assert read(traffic, 0.0).reconnects == 0
    for _ in range(3):
        traffic.opened()
    assert read(traffic, 0.0).reconnects == 2


def test_the_frames_are_the_codecs() -> None:
    codec, sender = Codec(), Codec()
    frames = [sender.encode(Vent(number)) for number in range(4)]
    codec.decode(frames[0] + b"garbage\x00" + frames[3] + b"\x05\x7f\x00\x00")
    now = Traffic().statistics(0.0, codec, HostSession(), 0)
    assert (now.good_frames, now.bad_frames, now.lost_frames) == (2, 2, 2)
