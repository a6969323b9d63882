"""Records the golden run anew: `cd tests && python -m firmware.record_golden_run`.

Run it only after a change of the firmware's behaviour, and read the difference before you commit it. The
inputs are a simulated phloSAR's pressures with noise, through a converter of 12 bits, and a host that
misbehaves.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from random import Random

from firmware_link.framing import encode_frame
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    ClearFaults,
    Codec,
    Fault,
    GetSetting,
    Hello,
    HostMessage,
    Mode,
    Ping,
    Setpoint,
    SetSetting,
    Vent,
    encode,
)
from flying_vines.physics.baseline import Inputs
from flying_vines.simulation.phlosar.firmware import setting_rows
from flying_vines.simulation.phlosar.mishaps import Open, Shorted
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar

from .golden_run import FULL_EVP_DUTY, GOLDEN_RUN, PACKET, Done, HostBoard, Part, PowerUp, Step, write

FULL_SCALE = 65535
SUPPLY = 59578
CV_SPAN_kPa, RESERVOIR_SPAN_kPa = 206.84, 1500.0
FULL_DVP_DUTY = 62258
IDS = {name: row.number for name, row in setting_rows().items()}
ALL_FAULTS = 0xFFFF
REPEAT_MS = 20
Wires = Callable[[int, int, int], tuple[int, int, int]]


def as_they_are(cv: int, reservoir: int, supply: int) -> tuple[int, int, int]:
    return cv, reservoir, supply


def instead(*, cv: int | None = None, reservoir: int | None = None, supply: int | None = None) -> Wires:
    """Replace the converter's counts by these."""

    def wires(seen_cv: int, seen_reservoir: int, seen_supply: int) -> tuple[int, int, int]:
        return (
            seen_cv if cv is None else cv,
            seen_reservoir if reservoir is None else reservoir,
            seen_supply if supply is None else supply,
        )

    return wires


class Recorder:
    """A board for `SimulatedPhlosar` that records its inputs and outputs."""

    def __init__(self, part: Part, power_up: PowerUp, clock_us: int) -> None:
        self.wires: Wires = as_they_are
        """Changes the counts between converter and core."""
        self.clock_us = clock_us
        """Lead of the board's clock over the simulated time. It grows if steps are late."""
        self.fetched = PACKET
        self.stored = power_up.stored
        self._power_up = power_up
        self._random = Random(part.name)
        self._part = part
        self._received = b""
        self._sent = b""
        self._board = self._begin(power_up)

    def _begin(self, power_up: PowerUp) -> HostBoard:
        self._part.inputs.append(power_up)
        return HostBoard(power_up)

    @property
    def mode(self) -> Mode:
        return Mode(self.last.mode)

    @property
    def faults(self) -> Fault:
        return Fault(self.last.faults)

    @property
    def number(self) -> int:
        return self.last.number

    @property
    def last(self) -> Done:
        return self._part.done[-1]

    def receive(self, data: bytes) -> None:
        self._received += data

    def take_output(self) -> bytes:
        sent, self._sent = self._sent, b""
        return sent

    def reset(self, *, watchdog: bool = False) -> None:
        self._power_up = self._power_up._replace(
            boot_id=self._power_up.boot_id + 1, by_watchdog=watchdog, stored=self.stored
        )
        self._board = self._begin(self._power_up)

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        noise = self._random.gauss
        supply = _converted(SUPPLY + noise(0.0, 6.0))
        cv = _converted((0.1 + 0.8 * cv_kPa / CV_SPAN_kPa) * supply)
        reservoir = _converted((0.1 + 0.8 * reservoir_kPa / RESERVOIR_SPAN_kPa) * supply)
        late_us = min(200, int(abs(noise(0.0, 8.0))))
        now_us = (now_us + self.clock_us + late_us) & 0xFFFFFFFF
        self.tell(Step(now_us, *self.wires(cv, reservoir, supply), self.fetched, self._received))
        return Inputs(
            min(1.0, self.last.evp_duty / FULL_EVP_DUTY),
            self.last.dvp_duty / FULL_DVP_DUTY,
            self.last.solenoid,
        )

    def tell(self, step: Step) -> None:
        self._received = b""
        done = self._board.step(step)
        self._part.inputs.append(step)
        self._part.done.append(done)
        self._sent += done.sent
        self.stored = done.kept or self.stored


def _converted(counts: float) -> int:
    """Counts of a converter of 12 bits."""
    return min(4095, max(0, round(counts / 16))) * 16


class World:
    """A recorded board on a simulated phloSAR, and its host."""

    def __init__(
        self,
        name: str,
        *,
        clock_us: int = 0,
        reservoir_kPa: float = 690.0,
        by_watchdog: bool = False,
        stored: bytes = b"",
        before: bytes = b"",
    ) -> None:
        self.part = Part(name, [], [])
        self.board = Recorder(self.part, PowerUp(0xB0A7, by_watchdog, "golden", stored), clock_us)
        self.board.receive(before)
        self.phlosar = SimulatedPhlosar(firmware=self.board, reservoir_kPa=reservoir_kPa, seed=7)
        self._codec = Codec()
        self._number = 0

    def say(self, *messages: HostMessage, then_ms: int = 2) -> None:
        self.board.receive(self.encoded(*messages))
        self.run(then_ms)

    def encoded(self, *messages: HostMessage) -> bytes:
        return b"".join(map(self._codec.encode, messages))

    def hear(self, data: bytes) -> None:
        """The codec needs the session of the board's `Welcome`."""
        self._codec.decode(data)

    def run(self, ms: int) -> None:
        self.hear(self.phlosar.advance(self.phlosar.now_s + ms / 1000))

    def greet(self) -> None:
        self.say(Hello(PROTOCOL_VERSION, 0x01020300))

    def hold(self, target_kPa: float, ms: int, rate_kPa_per_s: float = 200.0) -> None:
        self._number += 1
        for _ in range(0, ms, REPEAT_MS):
            self.say(Setpoint(target_kPa, rate_kPa_per_s, 250, self._number), then_ms=REPEAT_MS)

    def clear(self) -> None:
        self.say(ClearFaults(ALL_FAULTS))

    def with_wires(self, wires: Wires, ms: int) -> None:
        self.board.wires = wires
        self.run(ms)
        self.board.wires = as_they_are

    def is_in(self, mode: Mode, faults: Fault = Fault.NONE) -> None:
        """Check the board's state, so that the recording contains the case for which it is made."""
        assert (self.board.mode, self.board.faults) == (mode, faults), (self.board.mode, self.board.faults)


def handshake() -> World:
    early = encode(Hello(PROTOCOL_VERSION, 1), 0)
    world = World("handshake", before=early)
    world.run(25)
    world.say(Setpoint(10.0, 100.0, 250, 1), GetSetting(0), SetSetting(0, 20.0), ClearFaults(1), Vent(2))
    world.say(Ping(0), Ping(0xFFFF_FFFF_FFFF_FFFF), Hello(PROTOCOL_VERSION + 1, 0))
    world.say(Setpoint(10.0, 100.0, 250, 3))
    world.greet()
    world.hold(10.0, 60)
    world.is_in(Mode.REGULATE)
    # A host that returns ends the former regulation.
    world.greet()
    world.is_in(Mode.VENT)
    return world


def settings() -> World:
    world = World("settings")
    world.greet()
    for number in range(len(IDS) + 1):
        world.say(GetSetting(number))
    for number, row in enumerate(setting_rows().values()):
        beyond = math.nextafter(row.max, math.inf) + 1e-3
        world.say(SetSetting(number, row.max), SetSetting(number, beyond), SetSetting(number, row.min))
    for value in (math.nan, math.inf, -math.inf, -0.0, 1e-40):
        world.say(SetSetting(IDS["cv_zero_kPa"], value))
    world.say(SetSetting(255, 1.0), GetSetting(255))
    locked = bytes((SetSetting.TYPE, 9)) + struct.pack("<BfH", 0, 30.0, 0x5E76)
    world.board.receive(encode_frame(locked))
    world.run(2)
    for number, value in enumerate(
        (30.0, 2.0, 760.0, 200.0, 300.0, 33.0, CV_SPAN_kPa, 0.4, RESERVOIR_SPAN_kPa)
    ):
        world.say(SetSetting(number, value))
    for name, value in {"evp_dead_band": 0.2, "evp_full_duty": 0.6, "on_off_error_kPa": 2.5}.items():
        world.say(SetSetting(IDS[name], value))
    for name, value in {"filling_lead_s": 0.03, "proportional_per_kPa": 0.05, "venting_lead_s": 0.01}.items():
        world.say(SetSetting(IDS[name], value))
    world.say(SetSetting(IDS["integral_per_kPa_s"], 2.5))
    # The minimum limits were below the reservoir's pressure.
    world.is_in(Mode.FAULT, Fault.RESERVOIR_OVERPRESSURE)
    world.clear()
    # The session ended with the first changed setting.
    world.say(Setpoint(12.0, 200.0, 250, 8))
    world.greet()
    world.hold(12.0, 200)
    world.say(SetSetting(0, 25.0), then_ms=1)
    world.is_in(Mode.REGULATE)
    world.say(Vent(9), then_ms=20)
    world.board.reset()
    world.run(15)
    world.greet()
    world.say(*map(GetSetting, range(8)))
    world.hold(12.0, 200)
    world.is_in(Mode.REGULATE)
    return world


def inflation() -> World:
    world = World("inflation")
    world.greet()
    world.hold(20.0, 500)
    world.hold(21.0, 400, rate_kPa_per_s=5.0)
    world.hold(18.5, 300, rate_kPa_per_s=10.0)
    world.hold(2.0, 500)
    world.hold(6.0, 400)
    world.hold(0.0, 200)
    world.say(Vent(99), then_ms=50)
    return world


def weak_reservoir() -> World:
    world = World("weak reservoir", reservoir_kPa=95.0)
    world.greet()
    world.hold(15.0, 600)
    world.hold(3.0, 300)
    return world


def dead_man() -> World:
    world = World("dead-man, over the wrap of the clock", clock_us=(1 << 32) - 400_000)
    world.greet()
    world.hold(8.0, 360)
    world.run(300)
    world.is_in(Mode.FAULT, Fault.DEAD_MAN)
    world.hold(8.0, 40)
    world.is_in(Mode.FAULT, Fault.DEAD_MAN)
    world.say(ClearFaults(Fault.SUPPLY))
    world.is_in(Mode.FAULT, Fault.DEAD_MAN)
    world.clear()
    world.is_in(Mode.VENT)
    world.say(Setpoint(5.0, 50.0, 1, 500))
    world.is_in(Mode.FAULT, Fault.DEAD_MAN)
    world.clear()
    world.say(Setpoint(5.0, 50.0, 0xFFFF, 501), then_ms=302)
    world.is_in(Mode.FAULT, Fault.DEAD_MAN)
    world.clear()
    # A line that repeats its last bytes.
    hello = world.encoded(Hello(PROTOCOL_VERSION, 2))
    world.board.receive(hello)
    world.run(2)
    setpoint = world.encoded(Setpoint(5.0, 50.0, 250, 502))
    for _ in range(2):
        world.is_in(Mode.VENT if world.board.number != 502 else Mode.REGULATE)
        world.board.receive(setpoint)
        world.run(130)
    world.is_in(Mode.FAULT, Fault.DEAD_MAN)
    world.clear()
    world.board.receive(hello + setpoint)
    world.run(2)
    world.is_in(Mode.VENT)
    return world


def overpressure() -> World:
    world = World("over-pressure")
    world.greet()
    world.hold(27.9, 300)
    for wires, fault in (
        (instead(cv=14_000), Fault.CV_OVERPRESSURE),
        (instead(reservoir=35_000), Fault.RESERVOIR_OVERPRESSURE),
    ):
        world.hold(10.0, 20)
        world.with_wires(wires, 2)
        world.is_in(Mode.REGULATE)
        world.run(14)
        world.with_wires(wires, 3)
        world.is_in(Mode.FAULT, fault)
        # Three of sixteen readings still show it.
        world.run(11)
        world.clear()
        world.is_in(Mode.FAULT, fault)
        world.run(1)
        world.clear()
        world.is_in(Mode.VENT)
    # A sensor that flickers about the limit.
    world.hold(10.0, 20)
    for _ in range(3):
        world.with_wires(instead(cv=14_000), 1)
        world.run(4)
    world.is_in(Mode.FAULT, Fault.CV_OVERPRESSURE)
    world.run(16)
    world.clear()
    return world


def sensors() -> World:
    world = World("sensors")
    world.greet()
    for place, fault in (("cv_sensor", Fault.CV_SENSOR), ("reservoir_sensor", Fault.RESERVOIR_SENSOR)):
        for kind in (Open(), Shorted()):
            world.hold(9.0, 60)
            world.phlosar.inject(place, kind)
            world.run(8)
            world.is_in(Mode.FAULT, fault)
            world.clear()
            world.is_in(Mode.FAULT, fault)
            setattr(world.phlosar.mishaps, place, None)
            world.run(16)
            world.clear()
            world.is_in(Mode.VENT)
    return world


def supply() -> World:
    world = World("supply")
    world.greet()
    for counts in (53_620, 0, 65_501, FULL_SCALE):
        world.hold(9.0, 40)
        world.with_wires(instead(supply=counts), 2)
        world.is_in(Mode.REGULATE)
        world.run(14)
        world.with_wires(instead(supply=counts), 3)
        # Without supply there are no valid readings.
        world.is_in(Mode.FAULT, Fault.SUPPLY | Fault.CV_SENSOR | Fault.RESERVOIR_SENSOR)
        world.run(14)
        world.clear()
        world.is_in(Mode.VENT)
    for counts in (53_621, 65_500):

        def all_of_it(cv: int, reservoir: int, supply: int, counts: int = counts) -> tuple[int, int, int]:
            return round(cv * counts / supply), round(reservoir * counts / supply), counts

        # Only the ratio to the supply counts.
        world.with_wires(all_of_it, 10)
        world.is_in(Mode.VENT)
    return world


def broken_frames() -> World:
    world = World("broken frames")
    world.greet()
    chance = Random("broken frames")

    def good() -> bytes:
        return world.encoded(Setpoint(7.0, 80.0, 250, 77))

    for at in range(len(good())):
        frame = good()
        flipped = bytearray(frame)
        flipped[at] ^= 1 << chance.randrange(8)
        for data in (bytes(flipped), frame[:at], frame[at:], frame[:at] + frame[at + 1 :]):
            world.board.receive(data)
            world.run(1)
    longest = encode_frame(b"\x05\x00" + b"\xaa" * 126)
    for data in (longest, encode_frame(b""), encode_frame(b"\x03"), encode_frame(b"\x03\x00\x00"), bytes(40)):
        world.board.receive(data + good())
        world.run(3)
    world.board.receive(longest[:-1] + b"\x01\x00" + b"\x55" * 700)
    world.run(1)
    frame = good()
    world.board.receive(b"\x00" + frame[:7])
    world.run(1)
    world.board.receive(frame[7:])
    world.run(1)
    for kind in range(256):
        world.board.receive(
            encode_frame(bytes((kind, 0)) + chance.randbytes(chance.choice((0, 1, 2, 5, 7, 8, 12))))
        )
        if kind % 4 == 3:
            world.run(1)
    for _ in range(120):
        world.board.receive(chance.randbytes(chance.randrange(40)))
        world.run(1)
    world.board.receive(b"\x00")
    world.say(Vent(5))
    world.hold(7.0, 60)
    return world


def strange_setpoints() -> World:
    world = World("strange setpoints")
    world.greet()
    targets = (math.nan, math.inf, -math.inf, -0.0, -1e-30, 1e-40, 28.0, 28.000002, 30.0, 3.4e38)
    rates = (math.nan, math.inf, 0.0, -0.0, -5.0, 1e-40, 1e-6, 200.0, 3.4e38)
    number = 65_000
    for target in targets:
        for rate in rates:
            number += 1
            world.say(Setpoint(target, rate, 250, number), then_ms=1)
    world.say(Setpoint(5.0, 50.0, 0, 9), Setpoint(5.0, 50.0, 250, 0), then_ms=4)
    world.is_in(Mode.REGULATE)
    return world


def slow_port() -> World:
    world = World("a port that does not take what is sent")
    world.greet()
    world.board.fetched = 0
    for size in range(40):
        world.say(*(Ping(1 << shift) for shift in range(size % 5)), then_ms=10)
    world.board.fetched = 17
    world.run(100)
    world.board.fetched = 1024
    world.say(*map(Ping, range(80)), then_ms=20)
    return world


def telemetry_at_1000_hz() -> World:
    world = World("telemetry at 1000 Hz")
    world.greet()
    world.say(SetSetting(IDS["telemetry_Hz"], 1000.0))
    world.greet()
    world.hold(14.0, 260)
    world.hold(4.0, 200)
    # Far more requests than the queue of answers holds.
    world.say(*(GetSetting(number % 19) for number in range(58)), then_ms=4)
    world.say(SetSetting(IDS["telemetry_Hz"], 333.3), Vent(4))
    world.say(SetSetting(IDS["telemetry_Hz"], 333.3), then_ms=20)
    world.say(SetSetting(IDS["telemetry_Hz"], 10.0), then_ms=230)
    return world


def busy_line() -> World:
    """A frame in each step, and packets full of frames, with telemetry in each step."""
    world = World("a busy line")
    world.greet()
    world.say(SetSetting(IDS["telemetry_Hz"], 1000.0), then_ms=20)
    world.greet()
    for number in range(1, 260):
        world.say(Setpoint(12.0 + number % 2, 200.0, 250, number), then_ms=1)
    world.is_in(Mode.REGULATE)
    kinds: tuple[HostMessage, ...] = (
        *(Setpoint(13.0, 200.0, 250, 300), Ping((1 << 64) - 1), GetSetting(18), SetSetting(18, 0.02)),
        *(ClearFaults(ALL_FAULTS), Vent(301), SetSetting(18, 0.02), Hello(PROTOCOL_VERSION, 1)),
    )
    for message in kinds:
        for count in (1, PACKET // len(encode(message, 0))):
            for _ in range(8):
                world.board.receive(world.encoded(*[message] * count))
                world.run(1)
            world.board.fetched = 1024
            world.run(2)
            world.board.fetched = PACKET
    for filler in (b"\x00", b"\x01", b"\x01\x00", encode_frame(b"")):
        for _ in range(4):
            world.board.receive((filler * PACKET)[:PACKET])
            world.run(1)
    return world


def late_steps() -> World:
    world = World("late steps")
    world.greet()
    for late_us in (999, 1000, 5_300, 40_000, 249_000, 301_000):
        world.hold(8.0, 40)
        world.board.clock_us += late_us
        world.run(12)
        world.clear()
    return world


def watchdog() -> World:
    world = World("watchdog", by_watchdog=True)
    world.run(12)
    world.is_in(Mode.FAULT, Fault.WATCHDOG_RESET)
    world.greet()
    world.hold(5.0, 20)
    world.clear()
    world.is_in(Mode.VENT)
    world.hold(5.0, 40)
    world.phlosar.reset_firmware(watchdog=True)
    world.run(12)
    world.is_in(Mode.FAULT, Fault.WATCHDOG_RESET)
    return world


def stored_settings() -> World:
    kept = next(done.kept for done in reversed(settings().part.done) if done.kept)
    world = World("stored settings", stored=kept)
    world.run(12)
    world.is_in(Mode.VENT)
    flipped = [kept[:at] + bytes((kept[at] ^ 1,)) + kept[at + 1 :] for at in range(0, len(kept), 9)]
    for stored in (*flipped, kept[:-1], kept[:1], b"\x00" * len(kept), b"\xff\xfe" + kept[2:]):
        world.board.stored = stored
        world.board.reset()
        world.run(2)
    world.board.stored = b"\xff" * len(kept)
    world.board.reset()
    world.run(2)
    world.is_in(Mode.VENT)
    world.board.stored = flipped[2]
    world.board.reset()
    world.run(12)
    world.is_in(Mode.FAULT, Fault.SETTINGS)
    world.greet()
    world.say(GetSetting(0), GetSetting(7))
    world.clear()
    world.is_in(Mode.FAULT, Fault.SETTINGS)
    # An unchanged value stores all.
    world.say(SetSetting(0, 30.0))
    world.is_in(Mode.FAULT, Fault.SETTINGS)
    world.clear()
    world.is_in(Mode.VENT)
    return world


def random_mess() -> World:
    """Impossible readings, and a host that sends anything, for cases that nobody thought of."""
    world = World("a random mess", clock_us=(1 << 32) - 2_000_000)
    chance = Random("a random mess")
    board = world.board
    world.greet()
    cv, now_us, number = 8_000.0, (1 << 32) - 1_900_000, 0
    for ms in range(3000):
        now_us += 1000 + (chance.randrange(20_000) if chance.random() < 0.002 else chance.randrange(20))
        cv = min(14_500.0, max(5_000.0, cv + chance.gauss(0.0, 30.0 if ms % 400 < 300 else 500.0)))
        supply = 53_700 if ms % 700 < 50 else SUPPLY + chance.randrange(60)
        counts = int(cv), 20_000 + ms, supply
        if chance.random() < 0.01:
            counts = chance.randrange(1 << 16), chance.randrange(1 << 16), chance.choice((SUPPLY, 0))
        messages: list[HostMessage] = []
        if ms % 15 == 0:
            number += 1
            target, rate = chance.uniform(-0.5, 28.5), 10.0 ** chance.uniform(0.0, 2.6)
            messages.append(Setpoint(target, rate, chance.choice((250, 5, 40)), number))
        if chance.random() < 0.03:
            messages.append(ClearFaults(ALL_FAULTS))
        if chance.random() < 0.01:
            row = list(setting_rows().values())[chance.randrange(len(IDS))]
            messages += [Vent(number), SetSetting(row.number, chance.uniform(row.min, row.max))]
            if chance.random() < 0.5:
                messages.append(Hello(PROTOCOL_VERSION, ms))
        if chance.random() < 0.01:
            messages.append(chance.choice((Hello(PROTOCOL_VERSION, ms), Ping(ms), GetSetting(ms % 20))))
        world.hear(board.take_output())
        frames = bytearray(world.encoded(*messages))
        if frames and chance.random() < 0.1:
            frames[chance.randrange(len(frames))] = chance.randrange(256)
        fetched = chance.choice((PACKET, PACKET, 7))
        board.tell(Step(now_us & 0xFFFFFFFF, *counts, fetched, bytes(frames)))
    return world


def main() -> None:
    parts = (
        *(handshake, settings, inflation, weak_reservoir, dead_man, overpressure, sensors, supply),
        *(broken_frames, strange_setpoints, slow_port, telemetry_at_1000_hz, busy_line, late_steps),
        *(watchdog, stored_settings, random_mess),
    )
    worlds = [part() for part in parts]
    write(GOLDEN_RUN, [world.part for world in worlds])
    for world in worlds:
        print(f"{len(world.part.done):5} steps  {world.part.name}")
    print(f"{GOLDEN_RUN.stat().st_size} bytes in {GOLDEN_RUN.name}")


if __name__ == "__main__":
    main()
