"""The emulated firmware against the real core, step for step: random hosts, sensors, clocks and settings.

With the core counting in double precision, as Python does, every opening, every byte and every fault must be
the same. In single precision, behind the converter, the two may be apart by what rounding does to a regulator
that puffs: as far as a puff goes.
"""

from __future__ import annotations

import math
import random
import struct
from statistics import mean, median
from typing import NamedTuple

import pytest
from needed import needs_compiler

from firmware_link.framing import encode_frame
from firmware_link.host import HostSession, Regulate
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    ClearFaults,
    Codec,
    Fault,
    GetSetting,
    Hello,
    HostMessage,
    Message,
    Mode,
    Ping,
    Pong,
    Setpoint,
    SetSetting,
    Telemetry,
    Vent,
)
from flying_vines.simulation.phlosar.board import Board
from flying_vines.simulation.phlosar.compiled_firmware import CompiledFirmware
from flying_vines.simulation.phlosar.firmware import Drive, Firmware
from flying_vines.simulation.phlosar.firmware_settings import (
    SETTING_ROWS,
    CV_SENSOR_SPAN_kPa,
    FirmwareSettings,
    RESERVOIR_SENSOR_SPAN_kPa,
    SettingRow,
    value_of,
    with_value,
)
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar

pytestmark = needs_compiler

STEPS = 2000
TICK_S = 0.01
BUSY_S = 15.0
LIVES = 12
ODD_kPa = (math.nan, math.inf, -math.inf, -25.0, 1e30, 300.0, 0.0, 30.5, 1700.0)
ODD_FLOATS = (math.nan, math.inf, -math.inf, -1.0, 0.0, -0.0, 1e-30, 3.4e38)


def single(value: float) -> float:
    """As it is after a way through four bytes."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def within(dice: random.Random, row: SettingRow) -> float:
    """A value that the row takes, after its way through four bytes, too."""
    while True:
        # The end of the range may lie between two numbers of single precision.
        value = single(dice.choice((row.least, row.most, dice.uniform(row.least, row.most))))
        if row.least <= value <= row.most:
            return value


def settings(dice: random.Random) -> FirmwareSettings:
    """Half of the time a lab's; in single precision, for that is what a reset leaves of them."""
    made = FirmwareSettings(build="twin")
    for row in SETTING_ROWS:
        usual = single(value_of(made, row.name))
        value = within(dice, row) if dice.random() < 0.1 or not row.least <= usual <= row.most else usual
        changed = with_value(made, row, value)
        assert changed is not None
        made = changed
    return made


class Host:
    """Says what a host may say, and what it may not."""

    def __init__(self, dice: random.Random) -> None:
        self._dice = dice
        self._codec = Codec()
        self._number = 0
        self._target_kPa = 0.0

    def bytes_now(self) -> bytes:
        dice = self._dice
        chance = dice.random()
        if chance < 0.7:
            return b""
        if chance < 0.71:
            return dice.randbytes(dice.randrange(1, 300))
        if chance < 0.72:
            # A good frame of anything.
            kind = dice.randrange(0x00, 0x09)
            return encode_frame(bytes((kind, 0)) + dice.randbytes(dice.choice((0, 1, 2, 5, 7, 8, 12, 126))))
        data = self._codec.encode(self._message())
        if chance < 0.74:
            at = dice.randrange(len(data))
            data = data[:at] + bytes((dice.randrange(256),)) + data[at + dice.randrange(2) :]
        return data

    def _message(self) -> Message:
        dice = self._dice
        chance = dice.random()
        if chance < 0.85:
            return self._setpoint()
        kinds: list[HostMessage] = [
            Hello(PROTOCOL_VERSION if dice.random() < 0.9 else dice.randrange(256), dice.getrandbits(32)),
            Vent(dice.getrandbits(16)),
            ClearFaults(dice.getrandbits(16)),
            *[ClearFaults(0xFFFF)] * 4,
            Ping(dice.getrandbits(64)),
            GetSetting(dice.randrange(len(SETTING_ROWS) + 2)),
            self._set_setting(),
        ]
        return dice.choice((*kinds, Pong(1, 2)))

    def _setpoint(self) -> Setpoint:
        dice = self._dice
        odd = dice.random() < 0.05
        self._number = self._number % 0xFFFF + 1
        if dice.random() < 0.03:
            self._target_kPa = dice.choice((0.0, dice.uniform(0.0, 30.0), 5.0, 28.0))
        return Setpoint(
            dice.choice(ODD_FLOATS) if odd else self._target_kPa,
            dice.choice(ODD_FLOATS) if odd else dice.choice((20.0, 1e4, dice.uniform(0.1, 300.0))),
            dice.choice((0, 1, 30)) if odd else dice.choice((250, 65535)),
            self._number,
        )

    def _set_setting(self) -> SetSetting:
        dice = self._dice
        number = dice.randrange(len(SETTING_ROWS) + 1)
        if number == len(SETTING_ROWS) or dice.random() < 0.2:
            return SetSetting(number, dice.choice((*ODD_FLOATS, dice.uniform(-3000.0, 0.0), 2001.0)))
        return SetSetting(number, within(dice, SETTING_ROWS[number]))


class Air:
    """A crude vine and its sensors: enough for every branch of regulator and faults to be taken."""

    def __init__(self, dice: random.Random) -> None:
        self._dice = dice
        self._cv_kPa = 0.0
        self._reservoir_kPa = dice.choice((690.0, 300.0, 90.0, 0.0))
        self._speed = dice.choice((1.0, 0.3, 0.1))
        self._odd: list[tuple[float | None, float | None]] = []

    def read(self, drive: Drive, dt_s: float) -> tuple[float, float]:
        dice = self._dice
        flow = max(0.0, drive.evp - 0.15) * (self._reservoir_kPa - self._cv_kPa)
        out = (4.0 + 8.0 * drive.dvp) * (self._cv_kPa + 2.0 * drive.dvp) if drive.solenoid else 0.0
        self._cv_kPa += self._speed * (flow - out) * dt_s
        chance = dice.random()
        if chance < 0.002:
            odd = dice.choice(ODD_kPa)
            self._odd = [(odd, None) if dice.random() < 0.5 else (None, odd)] * dice.choice((1, 2, 2, 3, 9))
        elif chance < 0.0025:
            self._cv_kPa = dice.uniform(-5.0, 60.0)
        cv_kPa, reservoir_kPa = self._odd.pop() if self._odd else (None, None)
        return (
            self._cv_kPa + dice.gauss(0.0, 0.02) if cv_kPa is None else cv_kPa,
            self._reservoir_kPa + dice.gauss(0.0, 0.5) if reservoir_kPa is None else reservoir_kPa,
        )


class Twins(NamedTuple):
    model: Firmware
    core: CompiledFirmware

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Drive:
        told = self.model.step(now_us, cv_kPa, reservoir_kPa)
        # The core's converter, with its span and zero, is left out: it is told what the model makes of them.
        by = self.model.settings
        core = self.core.step(
            now_us,
            cv_kPa * (by.cv_span_kPa / CV_SENSOR_SPAN_kPa) + by.cv_zero_kPa,
            reservoir_kPa * (by.reservoir_span_kPa / RESERVOIR_SENSOR_SPAN_kPa) + by.reservoir_zero_kPa,
        )
        assert told == core
        assert (self.model.mode, self.model.faults, self.model.number) == (
            self.core.mode,
            self.core.faults,
            self.core.number,
        )
        return told

    def receive(self, data: bytes) -> None:
        self.model.receive(data)
        self.core.receive(data)

    def reset(self, *, watchdog: bool) -> None:
        self.model.reset(watchdog=watchdog)
        self.core.reset(watchdog=watchdog)

    def compare_output(self) -> bytes:
        told, core = self.model.take_output(), self.core.take_output()
        # As messages first: they say what differs.
        assert Codec().decode(told) == Codec().decode(core)
        assert told == core
        return told


def twins(start: FirmwareSettings) -> Twins:
    core = CompiledFirmware(start, boot_id=7, real="double", directly=True)
    return Twins(Firmware(start, boot_id=7), core)


class Met:
    """What a run came across; a run that meets little compares nothing."""

    def __init__(self) -> None:
        self.modes: set[Mode] = set()
        self.faults = Fault.NONE
        self.puffs = self.venturi = self.bytes_sent = self.frames_lost = 0

    def take(self, drive: Drive, model: Firmware) -> None:
        self.modes.add(model.mode)
        self.faults |= model.faults
        self.puffs += 0.0 < drive.evp < 1.0
        self.venturi += drive.dvp > 0.0


@pytest.mark.parametrize("group", range(4))
def test_the_model_is_the_core_to_the_last_bit(group: int) -> None:
    met = Met()
    for seed in range(group * LIVES, (group + 1) * LIVES):
        live(seed, met)
    assert met.modes == set(Mode)
    # Directly told pressures have no supply, and no memory is damaged here.
    assert met.faults == ~(Fault.SUPPLY | Fault.SETTINGS)
    assert met.puffs > 100
    assert met.venturi > 10
    assert met.bytes_sent > 50_000
    assert met.frames_lost > 100


def live(seed: int, met: Met) -> None:
    """One board's life, twice."""
    dice = random.Random(seed)
    both = twins(settings(dice))
    host, air = Host(dice), Air(dice)
    # Over the wrap of the board's clock.
    now_us = dice.choice((0, (1 << 32) - 700_000, (1 << 32) - 1))
    fetched_every = dice.choice((1, 5, 5, 200))
    ears = Codec()
    drive = Drive(0.0, 0.0, True)
    for step in range(STEPS):
        dt_us = 1000
        if dice.random() < 0.02:
            dt_us = dice.choice((1, 0, 0, 999, 1001, 1500, 7_000, 7_000, 250_000, 2_000_000))
        now_us += dt_us
        both.receive(host.bytes_now())
        if dice.random() < 0.001:
            both.reset(watchdog=dice.random() < 0.5)
            both.receive(host.bytes_now())
        drive = both.step(now_us, *air.read(drive, min(dt_us / 1e6, 0.002)))
        met.take(drive, both.model)
        if step % fetched_every == 0:
            sent = both.compare_output()
            met.bytes_sent += len(sent)
            ears.decode(sent)
    met.frames_lost += ears.lost_frames


class Driven:
    """A phloSAR and its host, in simulated time."""

    def __init__(self, board: Board, noise: int = 1) -> None:
        self.phlosar = SimulatedPhlosar(firmware=board, seed=noise)
        self._codec = Codec()
        self._session = HostSession()
        self._session.opened(0.0)

    def advance(self, t: float, command: Regulate) -> None:
        for message in self._codec.decode(self.phlosar.advance(t)):
            self._session.receive(t, message)
        for ours in (*self._session.command(t, command), *self._session.tick(t)):
            self.phlosar.receive(self._codec.encode(ours))


def test_single_precision_behind_a_converter_is_as_near_as_other_noise() -> None:
    """Half a count lets a puff or a vent come some milliseconds sooner, or not at all; so does noise."""
    dice = random.Random(1)
    model, core, other = Driven(Firmware()), Driven(CompiledFirmware()), Driven(Firmware(), noise=2)
    command, until_s = Regulate(0.0, 60.0), 0.0
    core_kPa, other_kPa = [], []
    for tick in range(round(BUSY_S / TICK_S)):
        t = tick * TICK_S
        if t >= until_s:
            command = Regulate(dice.choice((0.0, dice.uniform(0.0, 21.0))), dice.choice((5.0, 20.0, 60.0)))
            until_s = t + dice.uniform(0.3, 3.0)
        for driven in (model, core, other):
            driven.advance(t, command)
        core_kPa.append(abs(core.phlosar.cv_kPa - model.phlosar.cv_kPa))
        other_kPa.append(abs(other.phlosar.cv_kPa - model.phlosar.cv_kPa))
        assert model.phlosar.firmware.mode is core.phlosar.firmware.mode
        assert not model.phlosar.firmware.faults | core.phlosar.firmware.faults
    assert max(core_kPa) > 0.0
    assert median(core_kPa) < 1.5 * median(other_kPa)
    assert mean(core_kPa) < 1.5 * mean(other_kPa)
    # A whole vent, while the other has not decided on it.
    assert max(core_kPa) < 6.0


def test_spans_and_zeros_mean_the_same_behind_the_converter() -> None:
    dice = random.Random(1)
    for _ in range(50):
        start = FirmwareSettings(
            build="twin",
            cv_span_kPa=dice.uniform(150.0, 400.0),
            cv_zero_kPa=dice.uniform(-10.0, 10.0),
            reservoir_span_kPa=dice.uniform(1000.0, 2000.0),
            reservoir_zero_kPa=dice.uniform(-50.0, 50.0),
        )
        told = []
        cv_kPa, reservoir_kPa = dice.uniform(0.0, 25.0), dice.uniform(0.0, 700.0)
        for board in (Firmware(start), CompiledFirmware(start)):
            board.step(0, cv_kPa, reservoir_kPa)
            message = Codec().decode(board.take_output())[0]
            assert isinstance(message, Telemetry)
            told.append(message)
        # A count of the converter, and single precision.
        assert told[0].cv_kPa == pytest.approx(told[1].cv_kPa, abs=start.cv_span_kPa / 40_000)
        assert told[0].reservoir_kPa == pytest.approx(
            told[1].reservoir_kPa, abs=start.reservoir_span_kPa / 40_000
        )
