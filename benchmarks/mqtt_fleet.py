"""The number of vehicles that one mosquitto can serve: simulated vehicles, doubled until the broker fails.

    .venv/bin/python benchmarks/mqtt_fleet.py [--vehicles 1000] [--rate-Hz 2] [--seconds 10] [--most 32000]

Every vehicle has its own connection and sends like a real one: its state at the given rate, and its reservoir
with every fourth state, QoS 0. One subscriber receives everything. Broker, vehicles (two processes) and
subscriber share this machine; the table has the share of a core that each of them uses. The broker fails if a
message is lost or takes longer than 1 s. The benchmark also ends if the vehicles cannot send at their rate.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import multiprocessing
import os
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec
import process_cost

from flying_vines.gateway.mqtt.payloads import CyclesPayload, ReservoirPayload, StatePayload
from flying_vines.gateway.mqtt.topics import Topics

SENDERS = 2
TOO_LATE_S = 1.0
TOO_FEW = 0.98
"""Minimum share of the messages that the vehicles must send; with fewer, the broker is not the limit."""
RESERVOIR_EVERY = 4
"""One reservoir message for this number of states."""
DRAIN_S = 2.0
CLOCK = b"0000000000.000000"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, default=1000)
    parser.add_argument("--most", type=int, default=32_000)
    parser.add_argument("--rate-Hz", type=float, default=2.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    arguments = parser.parse_args()
    mosquitto = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if mosquitto is None:
        sys.exit("needs mosquitto: sudo apt install mosquitto")
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    load = os.getloadavg()[0]
    print(f"{os.cpu_count()} cores, load before {load:.1f}; a state is {len(state())} bytes")
    print(
        f"{'vehicles':>8} {'sent/s':>8} {'lost':>6} {'p50 ms':>8} {'p99 ms':>8} {'max ms':>8} "
        f"{'mosquitto':>10} {'RSS MB':>7} {'vehicles':>9} {'person':>7}"
    )
    vehicles, first_broke = arguments.vehicles, False
    while vehicles <= arguments.most:
        with serving(mosquitto) as (port, pid):
            result = run(port, pid, vehicles, arguments.rate_Hz, arguments.seconds)
        print(result, flush=True)
        if result.broke:
            print(f"breaks at {vehicles} vehicles: {result.broke}")
            first_broke = vehicles == arguments.vehicles
            break
        vehicles *= 2
    sys.exit(1 if first_broke else 0)


@dataclass(frozen=True)
class Result:
    vehicles: int
    wanted_per_s: float
    sent: int
    seconds: float
    late_s: list[float]
    """Delay of each received message from vehicle to subscriber, sorted."""
    broker_share: float
    broker_MB: float
    senders_share: float
    person_share: float

    @property
    def lost(self) -> int:
        return self.sent - len(self.late_s)

    @property
    def broke(self) -> str:
        if self.lost:
            return f"{self.lost} messages lost"
        if self.late_s[-1] > TOO_LATE_S:
            return f"a message took {self.late_s[-1]:.1f} s"
        if self.sent < TOO_FEW * self.wanted_per_s * self.seconds:
            return "the vehicles cannot send so much on this machine"
        return ""

    def __str__(self) -> str:
        p50, p99, most = (1000 * self.late_s[int(q * (len(self.late_s) - 1))] for q in (0.5, 0.99, 1.0))
        return (
            f"{self.vehicles:8} {self.sent / self.seconds:8.0f} {self.lost:6} {p50:8.2f} {p99:8.2f} "
            f"{most:8.1f} {self.broker_share:10.1%} {self.broker_MB:7.1f} {self.senders_share:9.1%} "
            f"{self.person_share:7.1%}"
        )


def state() -> bytes:
    """A real state message. The time is inserted when it is sent."""
    return _timeless(
        StatePayload(
            unix_s=0.0,
            t=81234.568712,
            vehicle="ArduPilot 1",
            mode="AUTO",
            armed=True,
            altitude_m=24.813,
            rc="good",
            switch_position=2,
            firmware="ready",
            reservoir_kPa=612.482,
            cv_kPa=20.613,
            command_kPa=20.7,
            bend_deg=59.724,
            doing="bend-full",
            safe_state={},
            pneumatics_armed=True,
            bench=False,
        )
    )


def reservoir() -> bytes:
    return _timeless(
        ReservoirPayload(
            unix_s=0.0,
            reservoir_kPa=612.482,
            cycles=CyclesPayload(31.24, 27.91, 35.03, 12.0, 18.42, 15.0, 1.4, 80.2, 65.4, 110.3, False),
        )
    )


def _timeless(payload: StatePayload | ReservoirPayload) -> bytes:
    return msgspec.json.encode(payload).replace(b'"unix_s":0.0', b'"unix_s":' + CLOCK)


@contextlib.contextmanager
def serving(mosquitto: str) -> Iterator[tuple[int, int]]:
    """Start a broker with default settings and its own port; yields port and process id."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / "mosquitto.conf"
        settings.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
        process = subprocess.Popen([mosquitto, "-c", settings], stderr=subprocess.DEVNULL)
        try:
            for _ in range(200):
                with socket.socket() as probe:
                    if probe.connect_ex(("127.0.0.1", port)) == 0:
                        break
                time.sleep(0.02)
            yield port, process.pid
        finally:
            process.kill()
            process.wait()


def run(port: int, broker: int, vehicles: int, rate_Hz: float, seconds: float) -> Result:
    ours, theirs = multiprocessing.Pipe()
    person = multiprocessing.Process(target=_listen, args=(port, theirs))
    person.start()
    ours.recv()
    senders = []
    for number in range(SENDERS):
        mine, its = multiprocessing.Pipe()
        names = [f"vehicle-{vehicle:05}" for vehicle in range(number, vehicles, SENDERS)]
        process = multiprocessing.Process(target=_send, args=(port, names, rate_Hz, its))
        process.start()
        senders.append((process, mine))
    for _, mine in senders:
        mine.recv()
    pids = [process.pid or 0 for process, _ in senders]
    before = [process_cost.cpu_s(pid) for pid in (broker, person.pid or 0, *pids)]
    for _, mine in senders:
        mine.send(seconds)
    time.sleep(seconds)
    after = [process_cost.cpu_s(pid) for pid in (broker, person.pid or 0, *pids)]
    used = [(end - begin) / seconds for begin, end in zip(before, after, strict=True)]
    sent = sum(mine.recv() for _, mine in senders)
    time.sleep(DRAIN_S)
    memory = process_cost.memory(broker)
    ours.send(None)
    late_s = ours.recv()
    for process in (person, *(process for process, _ in senders)):
        process.join()
    per_s = vehicles * rate_Hz * (1 + 1 / RESERVOIR_EVERY)
    return Result(
        vehicles, per_s, sent, seconds, sorted(late_s), used[0], memory.now_MB, sum(used[2:]), used[1]
    )


# The vehicles. MQTT 3.1.1 by hand, because a library would cost more than the broker.


def _send(port: int, names: list[str], rate_Hz: float, lead: Connection) -> None:
    asyncio.run(_send_all(port, names, rate_Hz, lead))


async def _send_all(port: int, names: list[str], rate_Hz: float, lead: Connection) -> None:
    writers = []
    for begin in range(0, len(names), 50):
        writers += await asyncio.gather(*(_connect(port, name) for name in names[begin : begin + 50]))
    states, reservoirs = (
        [_publication(topic, payload) for topic in topics]
        for topics, payload in (
            ([Topics("flying-vines", name).state for name in names], state()),
            ([Topics("flying-vines", name).reservoir for name in names], reservoir()),
        )
    )
    lead.send("connected")
    seconds = await asyncio.to_thread(lead.recv)
    began, sent, turn = time.perf_counter(), 0, 0
    each_s = 1.0 / (rate_Hz * len(names))
    while (passed_s := time.perf_counter() - began) < seconds:
        # The vehicles that are due: they are spread evenly over each period.
        while turn * each_s <= passed_s:
            period, vehicle = divmod(turn, len(names))
            _write(writers[vehicle], states[vehicle])
            sent += 1
            if (period + vehicle) % RESERVOIR_EVERY == 0:
                _write(writers[vehicle], reservoirs[vehicle])
                sent += 1
            turn += 1
            if turn % 200 == 0:
                await asyncio.sleep(0)
                passed_s = min(time.perf_counter() - began, seconds)
        await asyncio.sleep(0.002)
    lead.send(sent)
    await asyncio.sleep(DRAIN_S)
    for writer in writers:
        writer.close()


def _write(writer: asyncio.StreamWriter, parts: tuple[bytes, bytes]) -> None:
    before, after = parts
    writer.write(b"%b%017.6f%b" % (before, time.time(), after))


def _publication(topic: str, payload: bytes) -> tuple[bytes, bytes]:
    """The bytes before and after the time."""
    before, after = publish_packet(topic, payload).split(CLOCK)
    return before, after


def connect_packet(name: str) -> bytes:
    """MQTT 3.1.1: a clean session, kept alive for 300 s."""
    return _packet(b"\x10", b"\x00\x04MQTT\x04\x02\x01\x2c" + _text(name))


def publish_packet(topic: str, payload: bytes, retain: bool = False) -> bytes:
    return _packet(b"\x31" if retain else b"\x30", _text(topic) + payload)


def _text(text: str) -> bytes:
    encoded = text.encode()
    return len(encoded).to_bytes(2, "big") + encoded


def _packet(first: bytes, body: bytes) -> bytes:
    return first + _length_field(len(body)) + body


def _length_field(size: int) -> bytes:
    encoded = b""
    while size > 127:
        encoded += bytes([size % 128 + 128])
        size //= 128
    return encoded + bytes([size])


async def _connect(port: int, name: str) -> asyncio.StreamWriter:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(connect_packet(name))
    if await reader.readexactly(4) != b"\x20\x02\x00\x00":
        raise ConnectionError("the broker refuses")
    return writer


# The subscriber.


def _listen(port: int, lead: Connection) -> None:
    """Receive until told to stop. Then send the delay of each message, in seconds."""
    late_s: list[float] = []
    with socket.create_connection(("127.0.0.1", port)) as broker:
        broker.sendall(connect_packet("person"))
        broker.sendall(b"\x82\x13\x00\x01\x00\x0eflying-vines/#\x00")
        assert broker.recv(64).startswith(b"\x20\x02\x00\x00")
        lead.send("subscribed")
        unread = b""
        broker.settimeout(0.1)
        while not lead.poll():
            with contextlib.suppress(TimeoutError):
                unread = _take(unread + broker.recv(1 << 20), late_s)
    lead.send(late_s)


def _take(data: bytes, late_s: list[float]) -> bytes:
    """Note the delay of every whole message. Returns the remaining bytes."""
    now, at, end = time.time(), 0, len(data)
    while at + 5 < end:
        size, shift, body = 0, 0, at + 1
        while True:
            size |= (data[body] & 127) << shift
            shift += 7
            body += 1
            if data[body - 1] < 128:
                break
        if body + size > end:
            break
        if data[at] & 0xF0 == 0x30:
            clock = data.index(b'"unix_s":', body) + 9
            late_s.append(now - float(data[clock : clock + len(CLOCK)]))
        at = body + size
    return data[at:]


if __name__ == "__main__":
    main()
