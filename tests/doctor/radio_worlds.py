"""The guided radio test on real recordings, with a person who presses Enter at given times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.config.config import Config
from flying_vines.doctor.radio_test import RadioTest
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mavlink.tlog import TlogReader

RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"
DEFAULT = config.default()
TICK_S = 0.05


def recorded(name: str, from_s: float, until_s: float) -> Iterator[tuple[float, MavlinkMessage]]:
    """The autopilot's messages between two times, with a disarmed vehicle."""
    codec, began = MavlinkCodec(99, 191), None
    for unix_s, frame in TlogReader(RECORDINGS / f"{name}.tlog").frames():
        began = unix_s if began is None else began
        t = unix_s - began
        for message in codec.decode(frame):
            if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1 or not from_s <= t <= until_s:
                continue
            if message.get_type() == "HEARTBEAT":
                message.base_mode &= ~mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            yield t, message


def run_on(
    name: str,
    from_s: float,
    until_s: float,
    presses: Sequence[float] = (),
    target: int = 0,
    conf: Config = DEFAULT,
) -> RadioTest:
    """Run the test on a part of a recording. It begins with the switch in position `target`."""
    test, waiting, now = RadioTest(conf), sorted(presses), from_s
    test.target = target
    for t, message in recorded(name, from_s, until_s):
        while now + TICK_S < t:
            now += TICK_S
            while waiting and waiting[0] <= now:
                test.press(waiting.pop(0))
            test.advance(now)
        test.take(t, message)
    return test
