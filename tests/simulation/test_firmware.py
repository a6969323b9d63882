"""The firmware's core: handshake, dead-man, latches, settings, regulator, and what must never happen."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from examples import examples
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
    Refusal,
    RefusalReason,
    Setpoint,
    SetSetting,
    Setting,
    SettingsMemory,
    Telemetry,
    Vent,
    Welcome,
)
from flying_vines.physics.baseline import Inputs
from flying_vines.simulation.phlosar.firmware import SAFE, Firmware, setting_rows, standard_tuning
from flying_vines.simulation.phlosar.firmware import Regulator as CoreRegulator

RELIEF = Inputs(0.0, 1.0, True)
"""Above the limit the Venturi helps."""


class Bench:
    """A firmware whose sensors the test sets, and a host's codec."""

    def __init__(self, firmware: Firmware, cv_kPa: float = 0.0) -> None:
        self.firmware = firmware
        self.codec = Codec()
        self.now_ms = 0
        self.cv_kPa = cv_kPa
        self.reservoir_kPa = 690.0
        self.drive = SAFE
        self._told: list[Message] = []
        self.run(1)
        self.answers()

    def run(self, steps: int) -> Inputs:
        for _ in range(steps):
            self.drive = self.firmware.step(self.now_ms * 1000, self.cv_kPa, self.reservoir_kPa)
            self.now_ms += 1
        return self.drive

    def send(self, *messages: HostMessage) -> None:
        for message in messages:
            self.firmware.receive(self.codec.encode(message))
            # The codec learns the session of a `Welcome` before it encodes the next setpoint.
            self._told += self.codec.decode(self.firmware.take_output())

    def answers(self) -> list[Message]:
        told, self._told = self._told, []
        return told + self.codec.decode(self.firmware.take_output())

    def welcome(self, nonce: int = 7) -> Welcome:
        self.send(Hello(PROTOCOL_VERSION, nonce))
        return [answer for answer in self.answers() if isinstance(answer, Welcome)][-1]

    def refusals(self) -> list[Refusal]:
        return [answer for answer in self.answers() if isinstance(answer, Refusal)]

    def greet(self) -> None:
        self.send(Hello(PROTOCOL_VERSION, 7))
        self.answers()


@pytest.fixture
def cold() -> Bench:
    """A board that has just started."""
    return Bench(Firmware(directly=True))


@pytest.fixture
def bench(cold: Bench) -> Bench:
    """A board after the handshake."""
    cold.greet()
    return cold


def bend(number: int = 1, target_kPa: float = 15.0, rate: float = 50.0, ttl_ms: int = 250) -> Setpoint:
    return Setpoint(target_kPa, rate, ttl_ms, number)


def modes(bench: Bench) -> tuple[Mode, Fault]:
    return bench.firmware.mode, bench.firmware.faults


def test_it_vents_from_power_up_and_reports_it(cold: Bench) -> None:
    bench = cold
    assert bench.run(1) == SAFE
    bench.run(10)
    (telemetry,) = bench.answers()
    assert isinstance(telemetry, Telemetry)
    assert (telemetry.mode, telemetry.solenoid, telemetry.number) == (Mode.VENT, True, 0)


def test_the_handshake(cold: Bench) -> None:
    bench = cold
    bench.send(Hello(PROTOCOL_VERSION, 99))
    (answer,) = bench.answers()
    assert isinstance(answer, Welcome)
    assert (answer.protocol_version, answer.nonce, answer.boot_id) == (PROTOCOL_VERSION, 99, 1)
    assert (answer.cv_limit_kPa, answer.dead_man_ms, answer.telemetry_Hz) == (30.0, 300, 100)


def test_another_version_is_refused_and_so_are_its_setpoints(cold: Bench) -> None:
    bench = cold
    bench.send(Hello(PROTOCOL_VERSION + 1, 99), bend(number=4))
    answers = bench.answers()
    assert isinstance(answers[0], Welcome)
    assert answers[1:] == [Refusal(0, RefusalReason.VERSION), Refusal(4, RefusalReason.NO_HANDSHAKE)]


def test_before_the_handshake_only_vent_and_ping_are_executed(cold: Bench) -> None:
    bench = cold
    bench.send(bend(number=3), ClearFaults(0xFFFF), Vent(8), Ping(123))
    assert bench.answers() == [
        Refusal(3, RefusalReason.NO_HANDSHAKE),
        Refusal(0, RefusalReason.NO_HANDSHAKE),
        Pong(123, 0),
    ]
    assert bench.firmware.number == 8


def test_telemetry_comes_at_its_rate(bench: Bench) -> None:
    times = []
    for _ in range(100):
        bench.run(10)
        times += [answer.device_time_ms for answer in bench.answers() if isinstance(answer, Telemetry)]
    assert len(times) == 100
    assert {after - before for before, after in pairwise(times)} == {10}


def test_telemetry_reports_the_held_setpoint(bench: Bench) -> None:
    bench.cv_kPa = 2.0
    bench.run(1)
    bench.send(bend(number=12, rate=50.0))
    bench.run(100)
    telemetry = bench.answers()[-1]
    assert isinstance(telemetry, Telemetry)
    assert (telemetry.mode, telemetry.number, telemetry.cv_kPa) == (Mode.REGULATE, 12, 2.0)
    assert telemetry.setpoint_kPa == pytest.approx(2.0 + 0.1 * 50.0, abs=0.6)
    assert telemetry.evp_opening == 1.0


@pytest.mark.parametrize(
    ("setpoint", "reason"),
    [
        (bend(target_kPa=math.nan), RefusalReason.NOT_A_NUMBER),
        (bend(target_kPa=math.inf), RefusalReason.NOT_A_NUMBER),
        (bend(rate=math.nan), RefusalReason.NOT_A_NUMBER),
        (bend(target_kPa=-0.1), RefusalReason.OUT_OF_RANGE),
        (bend(target_kPa=28.1), RefusalReason.OUT_OF_RANGE),
        (bend(rate=0.0), RefusalReason.OUT_OF_RANGE),
        (bend(rate=-1.0), RefusalReason.OUT_OF_RANGE),
        (bend(ttl_ms=0), RefusalReason.OUT_OF_RANGE),
    ],
)
def test_setpoints_that_are_refused(bench: Bench, setpoint: Setpoint, reason: RefusalReason) -> None:
    bench.send(setpoint)
    assert bench.refusals() == [Refusal(1, reason)]
    assert bench.run(5) == SAFE


def test_a_refused_setpoint_leaves_what_is_held(bench: Bench) -> None:
    bench.send(bend(number=1), bend(number=2, target_kPa=99.0))
    assert bench.refusals() == [Refusal(2, RefusalReason.OUT_OF_RANGE)]
    bench.run(1)
    assert (bench.firmware.mode, bench.firmware.number) == (Mode.REGULATE, 1)


def test_silence_vents_and_latches(bench: Bench) -> None:
    bench.send(bend(ttl_ms=100))
    bench.run(99)
    assert modes(bench) == (Mode.REGULATE, Fault.NONE)
    assert bench.run(1) == SAFE
    assert modes(bench) == (Mode.FAULT, Fault.DEAD_MAN)
    bench.send(bend(number=2))
    assert bench.refusals() == [Refusal(2, RefusalReason.FAULT_LATCHED)]
    bench.send(ClearFaults(Fault.DEAD_MAN))
    assert modes(bench) == (Mode.VENT, Fault.NONE)
    bench.send(bend(number=3))
    bench.run(1)
    assert modes(bench) == (Mode.REGULATE, Fault.NONE)


def test_no_time_to_live_outlasts_the_dead_man(bench: Bench) -> None:
    bench.send(bend(ttl_ms=65535))
    bench.run(299)
    assert bench.firmware.mode is Mode.REGULATE
    bench.run(1)
    assert bench.firmware.faults == Fault.DEAD_MAN


def test_repetition_keeps_it_alive(bench: Bench) -> None:
    for _ in range(50):
        bench.send(bend(ttl_ms=60))
        bench.run(50)
    assert bench.firmware.mode is Mode.REGULATE


@pytest.mark.parametrize("frames", [1, 7, 300])
@pytest.mark.parametrize("every_ms", [1, 20])
def test_a_line_that_repeats_its_last_bytes_keeps_nothing_alive(
    bench: Bench, frames: int, every_ms: int
) -> None:
    """A bridge, stuck after the host has died, repeats a buffer of one or of several setpoints for ever."""
    buffer = [bench.codec.encode(bend(number)) for number in range(1, frames + 1)]
    for frame in buffer:
        bench.firmware.receive(frame)
        bench.run(1)
    assert modes(bench) == (Mode.REGULATE, Fault.NONE)
    ended_ms = bench.now_ms
    for ms in range(2000):
        if ms % every_ms == 0:
            bench.firmware.receive(buffer[ms // every_ms % frames])
        bench.run(1)
        if bench.firmware.mode is not Mode.REGULATE:
            break
    assert bench.now_ms - ended_ms <= 250
    assert modes(bench) == (Mode.FAULT, Fault.DEAD_MAN)


def test_a_repeated_handshake_enables_no_repeated_setpoint(bench: Bench) -> None:
    """The host clears the fault and dies; the line repeats the whole session before it."""
    hello = bench.codec.encode(Hello(PROTOCOL_VERSION, 8))
    bench.firmware.receive(hello)
    bench.answers()
    session = [hello, bench.codec.encode(Vent(1)), *(bench.codec.encode(bend(2)) for _ in range(10))]
    for frame in session[1:]:
        bench.firmware.receive(frame)
        bench.run(20)
    assert bench.firmware.mode is Mode.REGULATE
    for _ in range(5):
        for frame in session:
            bench.firmware.receive(frame)
            assert bench.run(20) == SAFE
    assert RefusalReason.NO_HANDSHAKE in {refusal.reason for refusal in bench.refusals()}
    bench.firmware.reset()
    bench.run(1)
    for frame in session:
        bench.firmware.receive(frame)
        assert bench.run(20) == SAFE


def test_every_handshake_of_every_boot_has_its_own_session(bench: Bench) -> None:
    sessions = []
    for _ in range(20):
        sessions += [bench.welcome().session for _ in range(20)]
        bench.firmware.reset()
        bench.run(1)
    assert len(set(sessions)) == 400


def test_a_vent_is_carried_out_however_old_it_is(bench: Bench) -> None:
    old = bench.codec.encode(Vent(1))
    bench.send(bend(number=9))
    for _ in range(3):
        bench.send(bend(number=9))
        bench.run(1)
        assert bench.firmware.mode is Mode.REGULATE
        bench.firmware.receive(old)
        assert bench.run(1) == SAFE


def test_a_stall_of_the_board_is_no_excuse(bench: Bench) -> None:
    bench.send(bend())
    bench.now_ms += 5000
    assert bench.run(1) == SAFE
    assert bench.firmware.faults == Fault.DEAD_MAN


def test_vent_while_venting_needs_no_repetition(bench: Bench) -> None:
    bench.send(bend(), Vent(2))
    bench.run(2000)
    assert (bench.firmware.mode, bench.firmware.number) == (Mode.VENT, 2)


def test_vent_never_runs_the_venturi(bench: Bench) -> None:
    bench.cv_kPa = 25.0
    bench.send(Vent(1))
    assert {bench.run(1) for _ in range(500)} == {SAFE}


def test_vent_is_accepted_while_a_fault_is_latched(bench: Bench) -> None:
    bench.cv_kPa = 31.0
    bench.run(3)
    bench.send(Vent(5))
    assert bench.refusals() == []
    assert (bench.firmware.number, bench.firmware.mode) == (5, Mode.FAULT)


def test_the_venturi_helps_over_the_limit_and_no_longer(bench: Bench) -> None:
    bench.cv_kPa = 31.0
    assert bench.run(3) == RELIEF
    bench.reservoir_kPa = 99.0
    assert bench.run(1) == SAFE
    bench.reservoir_kPa = 690.0
    assert {bench.run(1) for _ in range(99)} == {SAFE}
    assert bench.run(1) == RELIEF
    bench.cv_kPa = math.nan
    assert bench.run(3) == SAFE
    bench.cv_kPa = 31.0
    assert bench.run(1) == RELIEF
    bench.cv_kPa = 29.9
    assert bench.run(1) == SAFE
    assert bench.firmware.faults == Fault.CV_OVERPRESSURE | Fault.CV_SENSOR


def relief_steps(bench: Bench, *cv_kPa: float, steps: int) -> int:
    """For how many of the steps the Venturi runs while the vine's sensor repeats these readings."""
    found = 0
    for step in range(steps):
        bench.cv_kPa = cv_kPa[step % len(cv_kPa)]
        found += bench.run(1) == RELIEF
    return found


@pytest.mark.parametrize(
    "readings", [(31.0,), (31.0, 29.0), (31.0, 32.0, 33.0, 31.0, 29.9), (31.0, math.nan)]
)
def test_the_venturi_helps_for_a_second_in_total(bench: Bench, readings: tuple[float, ...]) -> None:
    """A noisy sensor at the limit would empty the reservoir and collapse the vine."""
    assert relief_steps(bench, *readings, steps=25_000) == 1000
    assert relief_steps(bench, 29.0, steps=50) == 0
    assert relief_steps(bench, 31.0, steps=50) == 0
    assert relief_steps(bench, 29.0, steps=50) == 0
    bench.send(ClearFaults(0xFFFF))
    assert modes(bench) == (Mode.VENT, Fault.NONE)
    assert relief_steps(bench, 31.0, steps=5000) == 0


def rises_with_the_venturi(bench: Bench, kPa_per_s: float, steps: int) -> float:
    """The vine's highest pressure, if it rises while the Venturi runs, and is kept otherwise."""
    for _ in range(steps):
        bench.send(*([bend(2, 0.0, 200.0)] if bench.now_ms % 100 == 0 else []))
        bench.cv_kPa += kPa_per_s / 1000 * bench.run(1).dvp
    return bench.cv_kPa


@pytest.mark.parametrize(
    ("cv_kPa", "highest_kPa"), [(20.0, 24.0), (31.0, 55.0)], ids=["the pilot straightens", "above the limit"]
)
def test_a_venturi_that_blows_into_the_vine_is_shut_off(cv_kPa: float, highest_kPa: float) -> None:
    """Its exhaust is blocked: each second of it fills the vine to 300 kPa more."""
    bench = Bench(Firmware(directly=True))
    bench.greet()
    bench.cv_kPa = cv_kPa
    bench.run(3)
    assert rises_with_the_venturi(bench, 340.0, steps=5000) < highest_kPa
    assert Fault.VENTURI in bench.firmware.faults and bench.drive == SAFE
    bench.send(ClearFaults(0xFFFF))
    # Above the limit a person's request does not start the Venturi again.
    assert (Fault.VENTURI in bench.firmware.faults) is (cv_kPa > 30.0)
    assert rises_with_the_venturi(bench, 340.0, steps=5000) < highest_kPa + 4.0


def test_a_venturi_that_empties_a_vine_slowly_or_with_noise_is_not_shut_off(bench: Bench) -> None:
    bench.cv_kPa = 31.0
    bench.run(3)
    for step in range(900):
        # For a while after an over-pressure air may still flow in.
        bench.cv_kPa = 33.0 + min(step, 50) * 0.2 + 1.2 * (-1) ** step
        assert bench.run(1) == RELIEF
    assert bench.firmware.faults == Fault.CV_OVERPRESSURE


@pytest.mark.parametrize("flickers_ms", [1, 5, 20])
@pytest.mark.parametrize("cv_kPa", [20.0, 31.0])
def test_a_supply_near_the_least_one_does_not_switch_the_venturi_on_and_off(
    bench: Bench, cv_kPa: float, flickers_ms: int
) -> None:
    """With a blocked exhaust each short run would raise the vine, unseen."""
    bench.cv_kPa, bench.reservoir_kPa = cv_kPa, 99.0
    bench.run(3)
    for step in range(3000):
        bench.reservoir_kPa = 101.0 if step // flickers_ms % 2 else 99.0
        rises_with_the_venturi(bench, 340.0, steps=1)
    assert bench.cv_kPa < cv_kPa + 1.0


@pytest.mark.parametrize("wrong_kPa", [-20.0, 0.0, 60.0])
def test_single_wrong_readings_while_the_venturi_runs_are_no_fault(bench: Bench, wrong_kPa: float) -> None:
    bench.cv_kPa = 20.0
    bench.run(3)
    ran = 0
    for step in range(1000):
        bench.send(*([bend(2, 0.0, 200.0)] if step % 100 == 0 else []))
        right_kPa, bench.cv_kPa = bench.cv_kPa, wrong_kPa if step % 50 == 45 else bench.cv_kPa
        ran += bench.run(1).dvp > 0.0
        bench.cv_kPa = max(5.0, right_kPa - 0.03)
    assert ran > 500
    assert bench.firmware.faults == Fault.NONE


def test_a_board_that_starts_with_a_bent_vine_above_the_limit_relieves_it() -> None:
    bench = Bench(Firmware(directly=True), cv_kPa=90.0)
    bench.run(2)
    assert {bench.run(1) for _ in range(900)} == {RELIEF}
    assert bench.firmware.faults == Fault.CV_OVERPRESSURE


def test_clearing_the_fault_gives_the_venturi_no_further_second(bench: Bench) -> None:
    """Each move of the switch to straight clears it, while a contact reads too much now and then."""
    ran = 0
    for _ in range(40):
        ran += relief_steps(bench, 31.0, steps=1500)
        assert relief_steps(bench, 29.0, steps=20) == 0
        bench.send(ClearFaults(0xFFFF))
        assert modes(bench) == (Mode.VENT, Fault.NONE)
        assert relief_steps(bench, 29.0, steps=100) == 0
    assert 1000 <= ran <= 1100
    # It is regained in a minute without the fault.
    assert relief_steps(bench, 29.0, steps=60_000) == 0
    assert relief_steps(bench, 31.0, steps=5000) == 1000


@pytest.mark.parametrize("newer", [5, 65535])
def test_a_setpoint_that_was_overtaken_undoes_nothing(bench: Bench, newer: int) -> None:
    older = newer - 1
    bench.send(bend(older), Vent(newer), bend(older))
    assert bench.refusals() == [Refusal(older, RefusalReason.OVERTAKEN)]
    assert bench.run(1) == SAFE
    # The host counts from 65535 to 1, and a new handshake starts again.
    bench.send(bend(newer % 65535 + 1))
    bench.run(1)
    assert bench.firmware.mode is Mode.REGULATE
    bench.send(Hello(PROTOCOL_VERSION, 8), bend(older))
    bench.run(1)
    assert (bench.firmware.mode, bench.firmware.number) == (Mode.REGULATE, older)


def test_a_new_host_starts_from_vent(bench: Bench) -> None:
    bench.send(bend())
    bench.run(5)
    bench.send(Hello(PROTOCOL_VERSION, 8))
    assert bench.run(1) == SAFE
    assert bench.firmware.mode is Mode.VENT


@pytest.mark.parametrize(
    ("cv_kPa", "reservoir_kPa", "fault"),
    [
        (30.1, 690.0, Fault.CV_OVERPRESSURE),
        (math.nan, 690.0, Fault.CV_SENSOR),
        (-22.1, 690.0, Fault.CV_SENSOR),
        (229.0, 690.0, Fault.CV_SENSOR),
        (5.0, 761.0, Fault.RESERVOIR_OVERPRESSURE),
        (5.0, math.nan, Fault.RESERVOIR_SENSOR),
        (5.0, -160.0, Fault.RESERVOIR_SENSOR),
        (5.0, 1660.0, Fault.RESERVOIR_SENSOR),
        (math.inf, math.inf, Fault.CV_SENSOR | Fault.RESERVOIR_SENSOR),
    ],
)
def test_faults_vent_within_three_readings_and_latch(
    bench: Bench, cv_kPa: float, reservoir_kPa: float, fault: Fault
) -> None:
    bench.send(bend())
    bench.cv_kPa = 5.0
    bench.run(20)
    bench.cv_kPa, bench.reservoir_kPa = cv_kPa, reservoir_kPa
    bench.run(2)
    assert modes(bench) == (Mode.REGULATE, Fault.NONE)
    assert bench.run(1) == (RELIEF if fault is Fault.CV_OVERPRESSURE else SAFE)
    assert bench.firmware.faults == fault
    bench.send(ClearFaults(0xFFFF))
    assert bench.firmware.faults == fault
    bench.cv_kPa, bench.reservoir_kPa = 5.0, 690.0
    assert bench.run(16) == SAFE
    assert bench.firmware.faults == fault
    bench.send(bend(number=2))
    assert bench.refusals()[-1] == Refusal(2, RefusalReason.FAULT_LATCHED)
    bench.send(ClearFaults(0))
    assert bench.firmware.faults == fault
    bench.send(ClearFaults(fault))
    assert bench.firmware.mode is Mode.VENT


def test_invalid_readings_do_not_hide_an_over_pressure(bench: Bench) -> None:
    bench.send(bend())
    bench.run(1)
    for cv_kPa in (40.0, 40.0, 300.0, 300.0, 40.0):
        bench.cv_kPa = cv_kPa
        bench.run(1)
    assert bench.firmware.faults == Fault.CV_OVERPRESSURE


GOOD = (5.0, 690.0, 1.0)
"""Vine's pressure, reservoir's pressure, share of the sensors' supply."""
WRONG = {
    Fault.CV_SENSOR: (math.nan, 690.0, 1.0),
    Fault.RESERVOIR_SENSOR: (5.0, math.nan, 1.0),
    Fault.SUPPLY: (5.0, 690.0, 0.8),
    Fault.CV_OVERPRESSURE: (31.0, 690.0, 1.0),
    Fault.RESERVOIR_OVERPRESSURE: (5.0, 765.0, 1.0),
}


def regulates_for(fault: Fault, wrong: int, good: int, most_ms: int = 2000) -> int:
    """The time (ms) for which the board regulates on while `wrong` readings are followed by `good` ones."""
    bench = Bench(Firmware())
    bench.greet()
    bench.cv_kPa = 5.0
    bench.run(20)
    bench.send(bend())
    for ms in range(most_ms):
        if ms % 200 == 0:
            bench.send(bend())
        seen = WRONG[fault] if ms % (wrong + good) < wrong else GOOD
        bench.cv_kPa, bench.reservoir_kPa, bench.firmware.supply_share = seen
        bench.run(1)
        if bench.firmware.mode is not Mode.REGULATE:
            assert fault in bench.firmware.faults
            return ms + 1
    return most_ms


@pytest.mark.parametrize("fault", WRONG)
@pytest.mark.parametrize(
    ("wrong", "good", "ms"),
    [(10, 0, 3), (2, 1, 4), (1, 1, 5), (1, 2, 7), (2, 5, 8), (1, 4, 11), (1, 6, 15), (2, 13, 16)],
)
def test_a_contact_that_flickers_is_a_fault(fault: Fault, wrong: int, good: int, ms: int) -> None:
    assert regulates_for(fault, wrong, good) == ms


@pytest.mark.parametrize("fault", WRONG)
@pytest.mark.parametrize(("wrong", "good"), [(1, 7), (2, 14)])
def test_a_glitch_now_and_then_ends_nothing(fault: Fault, wrong: int, good: int) -> None:
    assert regulates_for(fault, wrong, good) == 2000


def test_a_glitch_is_not_reported(bench: Bench) -> None:
    bench.cv_kPa = 5.0
    bench.send(bend())
    bench.run(20)
    for glitch in (math.nan, 230.0, 35.0, -30.0):
        bench.cv_kPa = glitch
        bench.run(2)
        bench.cv_kPa = 5.0
        bench.run(14)
    assert modes(bench) == (Mode.REGULATE, Fault.NONE)
    told = [answer.cv_kPa for answer in bench.answers() if isinstance(answer, Telemetry)]
    assert set(told) <= {5.0, 35.0}


def test_the_regulator_uses_no_reading_older_than_two_steps(bench: Bench) -> None:
    """A third invalid reading ends the regulation, so the value that it holds is never older."""
    bench.cv_kPa = 20.0
    bench.run(20)
    bench.send(bend(target_kPa=1.0, rate=200.0))
    bench.run(20)
    bench.cv_kPa = math.nan
    regulated = 0
    while bench.firmware.mode is Mode.REGULATE:
        bench.run(1)
        regulated += bench.firmware.mode is Mode.REGULATE
    assert regulated == 2


def test_telemetry_of_a_broken_sensor_is_the_last_valid_reading(bench: Bench) -> None:
    bench.cv_kPa = 4.0
    bench.run(1)
    bench.cv_kPa = math.nan
    bench.run(20)
    telemetry = bench.answers()[-1]
    assert isinstance(telemetry, Telemetry)
    assert (telemetry.cv_kPa, telemetry.faults) == (4.0, Fault.CV_SENSOR)


def test_a_power_cycle_forgets_everything_but_the_boot_count(bench: Bench) -> None:
    bench.send(bend())
    bench.run(500)
    assert bench.firmware.faults
    bench.firmware.reset()
    bench.run(1)
    assert (bench.firmware.mode, bench.firmware.faults, bench.firmware.number) == (Mode.VENT, Fault.NONE, 0)
    bench.send(bend(number=9))
    assert bench.refusals() == [Refusal(9, RefusalReason.NO_HANDSHAKE)]
    bench.send(Hello(PROTOCOL_VERSION, 1))
    (answer,) = bench.answers()
    assert isinstance(answer, Welcome)
    assert answer.boot_id == 2


def test_a_watchdog_reset_latches(cold: Bench) -> None:
    bench = cold
    bench.firmware.reset(watchdog=True)
    bench.run(1)
    bench.greet()
    bench.send(bend(number=1))
    assert bench.refusals() == [Refusal(1, RefusalReason.FAULT_LATCHED)]
    assert bench.firmware.faults == Fault.WATCHDOG_RESET


def test_a_board_that_boots_does_not_listen() -> None:
    firmware = Firmware()
    firmware.receive(Codec().encode(Hello(PROTOCOL_VERSION, 1)))
    assert firmware.take_output() == b""


def test_output_without_a_reader_is_bounded(bench: Bench) -> None:
    bench.run(1000)
    output = bench.firmware.take_output()
    assert 900 < len(output) <= 1024
    frames = len(bench.codec.decode(output))
    bench.run(10)
    bench.answers()
    assert bench.codec.bad_frames == 0
    # The numbers of dropped frames are missing.
    assert bench.codec.lost_frames == 100 - frames


# Settings.


def setting(bench: Bench, name: str) -> Setting:
    """The answer to a request of a setting."""
    for number in range(100):
        bench.send(GetSetting(number))
        (answer,) = [answer for answer in bench.answers() if isinstance(answer, Setting)]
        if answer.name == name:
            return answer
    raise AssertionError(name)


def test_settings_name_themselves(bench: Bench) -> None:
    bench.send(GetSetting(0))
    (first,) = bench.answers()
    assert isinstance(first, Setting)
    assert (first.name, first.value, first.count) == ("cv_limit_kPa", 30.0, len(setting_rows()))
    for number, (name, row) in enumerate(setting_rows().items()):
        bench.send(GetSetting(number))
        wanted = (number, len(setting_rows()), name, row.standard, row.min, row.max, row.standard)
        assert bench.answers() == [Setting(*wanted)]
    bench.send(GetSetting(len(setting_rows())))
    assert bench.refusals() == [Refusal(0, RefusalReason.OUT_OF_RANGE)]


def test_a_setting_is_kept_over_a_reset(bench: Bench) -> None:
    limit = setting(bench, "cv_limit_kPa")
    bench.send(SetSetting(limit.id, 20.0))
    (answer,) = bench.answers()
    assert isinstance(answer, Setting)
    assert answer.value == 20.0
    bench.firmware.reset(watchdog=False)
    bench.run(1)
    bench.greet()
    assert not bench.firmware.faults
    bench.send(bend(target_kPa=18.5))
    assert bench.refusals() == [Refusal(1, RefusalReason.OUT_OF_RANGE)]
    bench.cv_kPa = 20.5
    bench.run(3)
    assert bench.firmware.faults == Fault.CV_OVERPRESSURE


def test_damaged_settings_stay_a_fault_until_settings_are_stored() -> None:
    """The standard span of another sensor makes every pressure wrong: no routine clearing may hide it."""
    damaged = bytearray(Firmware({"cv_span_kPa": 420.0})._stored)
    damaged[20] ^= 1
    bench = Bench(Firmware(stored=bytes(damaged)))
    assert bench.welcome().settings_memory is SettingsMemory.DAMAGED
    for _ in range(3):
        bench.send(ClearFaults(0xFFFF), bend())
        bench.run(1)
        assert modes(bench) == (Mode.FAULT, Fault.SETTINGS)
    # An unchanged value stores all of them.
    bench.send(SetSetting(0, 30.0))
    bench.firmware.reset()
    bench.run(1)
    assert bench.welcome().settings_memory is SettingsMemory.STORED
    assert modes(bench) == (Mode.VENT, Fault.NONE)


def test_after_the_store_damaged_settings_are_cleared_by_a_person() -> None:
    bench = Bench(Firmware(stored=b"\x00" * 82))
    bench.greet()
    bench.send(SetSetting(0, 30.0), ClearFaults(0xFFFF))
    assert modes(bench) == (Mode.FAULT, Fault.SETTINGS)
    assert bench.firmware.store()
    assert modes(bench) == (Mode.FAULT, Fault.SETTINGS)
    bench.send(ClearFaults(0xFFFF))
    assert modes(bench) == (Mode.VENT, Fault.NONE)
    assert not bench.firmware.store()


@pytest.mark.parametrize("erased", [b"", b"\xff" * 82])
def test_an_erased_memory_says_so_until_any_setting_is_stored(erased: bytes) -> None:
    bench = Bench(Firmware(stored=erased))
    welcome = bench.welcome()
    assert welcome.settings_memory is SettingsMemory.ERASED
    assert welcome.settings_digest == Bench(Firmware()).welcome().settings_digest
    bench.send(SetSetting(0, 30.0))
    assert bench.firmware.store()
    assert bench.welcome().settings_memory is SettingsMemory.STORED


def test_the_digest_differs_for_every_changed_setting(bench: Bench) -> None:
    digests = [bench.welcome().settings_digest]
    for row in setting_rows().values():
        bench.send(SetSetting(row.number, row.min if row.standard != row.min else row.max))
        digests.append(bench.welcome().settings_digest)
    assert len(set(digests)) == len(digests)
    for row in setting_rows().values():
        bench.send(SetSetting(row.number, row.standard))
    assert bench.welcome().settings_digest == digests[0]


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0, 301.0, 60_000.0])
def test_no_setting_switches_the_dead_man_off(bench: Bench, value: float) -> None:
    dead_man = setting(bench, "dead_man_ms")
    bench.send(SetSetting(dead_man.id, value))
    assert len(bench.refusals()) == 1
    assert setting(bench, "dead_man_ms").value == 300.0


def test_limits_do_not_change_under_a_bent_vine(bench: Bench) -> None:
    bench.send(bend())
    bench.send(SetSetting(0, 60.0))
    assert bench.refusals() == [Refusal(0, RefusalReason.REGULATING)]
    assert setting(bench, "cv_limit_kPa").value == 30.0


@pytest.mark.parametrize("value", [20.0, 30.0])
def test_a_changed_setting_ends_the_session_for_setpoints(bench: Bench, value: float) -> None:
    """Another host on the line, or a line that repeats bytes, may have changed it."""
    assert bench.firmware.settings["cv_limit_kPa"] == 30.0
    bench.firmware.receive(Codec().encode(SetSetting(0, value)))
    bench.send(bend(2))
    changed = value != 30.0
    assert bench.refusals() == [Refusal(2, RefusalReason.NO_HANDSHAKE)] * changed
    assert bench.firmware.mode is (Mode.VENT if changed else Mode.REGULATE)
    bench.greet()
    bench.send(bend(3))
    assert bench.firmware.mode is Mode.REGULATE


def test_settings_are_only_a_hosts_that_was_greeted(cold: Bench) -> None:
    cold.send(SetSetting(0, 20.0))
    assert cold.refusals() == [Refusal(0, RefusalReason.NO_HANDSHAKE)]


@pytest.mark.parametrize("name", ["dead_man_ms", "telemetry_Hz"])
def test_milliseconds_and_hertz_are_whole(bench: Bench, name: str) -> None:
    bench.send(SetSetting(setting(bench, name).id, 99.9))
    bench.answers()
    assert setting(bench, name).value == 99.0


def test_the_dead_band_is_jumped(bench: Bench) -> None:
    band = setting(bench, "evp_dead_band")
    bench.send(SetSetting(band.id, 0.3))
    bench.greet()
    bench.send(bend(target_kPa=1.0, rate=200.0))
    openings = [bench.run(1).evp for _ in range(200)]
    assert min(opening for opening in openings if opening > 0.0) >= 0.3
    assert max(openings) <= 1.0
    bench.send(Vent(3))
    assert bench.run(1) == SAFE


def test_a_sensors_zero_is_taken_off() -> None:
    bench = Bench(Firmware())
    bench.greet()
    bench.cv_kPa = 4.0
    zero = setting(bench, "cv_zero_kPa")
    bench.send(SetSetting(zero.id, -4.0))
    bench.run(20)
    telemetry = [answer for answer in bench.answers() if isinstance(answer, Telemetry)][-1]
    # The converter's steps are 0.004 kPa.
    assert telemetry.cv_kPa == pytest.approx(0.0, abs=0.003)


# The regulator alone.


class Regulator:
    """One regulation on a full reservoir, stepped at 1 kHz with given readings."""

    def __init__(
        self, cv_kPa: float, target_kPa: float, rate_kPa_per_s: float = 1000.0, **tuning: float
    ) -> None:
        self._regulator = CoreRegulator(tuning, cv_kPa=cv_kPa)
        self._aim = target_kPa, rate_kPa_per_s

    def step(self, cv_kPa: float, reservoir_kPa: float = 690.0) -> Inputs:
        return self._regulator.step(*self._aim, cv_kPa, reservoir_kPa)

    @property
    def setpoint_kPa(self) -> float:
        return self._regulator.setpoint_kPa


def test_the_setpoint_starts_at_the_measured_pressure_and_keeps_to_its_rate() -> None:
    regulator = Regulator(6.0, 10.0, 20.0)
    held = [6.0]
    for _ in range(400):
        regulator.step(6.0)
        held.append(regulator.setpoint_kPa)
    assert held[-1] == 10.0
    assert max(after - before for before, after in pairwise(held)) <= 0.0201


def test_within_the_dead_band_nothing_moves() -> None:
    regulator = Regulator(10.0, 10.0)
    for cv_kPa in (10.0, 10.25, 9.9):
        assert {regulator.step(cv_kPa) for _ in range(5000)} == {Inputs(0.0, 0.0, False)}


def test_the_integral_does_not_wind_up() -> None:
    regulator = Regulator(10.0, 10.8)
    for _ in range(10_000):
        drive = regulator.step(10.0)
    assert drive.evp == pytest.approx(standard_tuning()["integral_most"] + 0.8 * 0.03)
    assert [regulator.step(10.9) for _ in range(20)][-1] == Inputs(0.0, 0.0, False)


@pytest.mark.parametrize(("excess_kPa", "wait_ms"), [(0.5, 300), (3.0, 22)])
def test_a_little_too_much_is_given_time_to_cool(excess_kPa: float, wait_ms: int) -> None:
    regulator = Regulator(10.0, 10.0)
    waited = next(ms for ms in range(5000) if regulator.step(10.0 + excess_kPa).solenoid)
    assert waited == pytest.approx(wait_ms, abs=10)


def test_at_a_setpoint_of_nothing_the_way_out_is_open() -> None:
    regulator = Regulator(0.0, 0.0)
    assert {regulator.step(0.0) for _ in range(100)} == {SAFE}


def test_on_the_way_down_nothing_is_filled_up_again() -> None:
    regulator = Regulator(10.0, 0.0, 5.0)
    drives = [regulator.step(9.5 - 0.005 * ms) for ms in range(500)]
    assert not any(drive.evp for drive in drives)


def _falling(cv_slope_kPa_per_s: float, reservoir_kPa: float) -> list[Inputs]:
    """The valve commands while the setpoint falls from 20 kPa to 0 at 200 kPa/s."""
    regulator = Regulator(20.0, 0.0, 200.0)
    return [
        regulator.step(max(5.0, 20.0 - cv_slope_kPa_per_s * ms / 1000), reservoir_kPa) for ms in range(150)
    ]


def test_air_that_leaves_fast_enough_leaves_by_itself() -> None:
    drives = _falling(cv_slope_kPa_per_s=190.0, reservoir_kPa=690.0)
    assert any(drive.solenoid for drive in drives)
    # Near the end the pressure stays at 5 kPa: only there the Venturi may help.
    assert not any(drive.dvp for drive in drives[:79])


def test_the_venturi_helps_air_that_leaves_too_slowly() -> None:
    drives = _falling(cv_slope_kPa_per_s=20.0, reservoir_kPa=690.0)
    assert any(drive.dvp == 1.0 for drive in drives)
    assert all(drive.solenoid for drive in drives if drive.dvp)
    assert not any(drive.dvp for drive in drives[:30])


def test_no_air_is_spent_on_a_venturi_that_would_not_work() -> None:
    drives = _falling(cv_slope_kPa_per_s=20.0, reservoir_kPa=90.0)
    assert not any(drive.dvp for drive in drives)


# Guarantees for any input.

wild = st.one_of(st.floats(width=32), st.floats(-20.0, 40.0, width=32))
said: st.SearchStrategy[HostMessage | bytes] = st.one_of(
    st.builds(Hello, st.sampled_from([PROTOCOL_VERSION, PROTOCOL_VERSION, 1]), st.just(1)),
    st.builds(Setpoint, st.floats(0.0, 28.0, width=32), st.floats(0.5, 500.0, width=32), st.integers(1, 400),
              st.integers(0, 65535)),
    st.builds(Setpoint, wild, wild, st.integers(0, 65535), st.integers(0, 65535)),
    st.builds(Vent, st.integers(0, 65535)),
    st.builds(ClearFaults, st.integers(0, 65535)),
    st.builds(Ping, st.integers(0, 2**64 - 1)),
    st.builds(GetSetting, st.integers(0, 255)),
    st.builds(SetSetting, st.integers(0, 20), st.floats(0.0, 60.0, width=32)),
    st.binary(max_size=40),
)  # fmt: skip
pressures = st.one_of(st.floats(0.0, 29.0), st.floats(0.0, 29.0), st.floats(-30.0, 40.0), st.just(math.nan))
supplies = st.one_of(
    st.floats(0.0, 750.0), st.floats(0.0, 750.0), st.floats(-200.0, 1700.0), st.just(math.nan)
)
turns = st.tuples(st.lists(said, max_size=3), pressures, supplies, st.integers(1, 150))


Story = list[tuple[list[HostMessage | bytes], float, float, int]]


FULL_DUTY_LATER: Story = [*[([], 0.0, 0.0, 1)] * 6, ([], 30.0, 101.0, 3)]
"""An overpressure; `dvp_full_duty` is changed before it."""


@settings(max_examples=examples(200), deadline=None)
@example([([SetSetting(13, 0.5)], 0.0, math.nan, 1), *FULL_DUTY_LATER])
@example([([SetSetting(13, 1.0)], 0.0, math.nan, 1), *FULL_DUTY_LATER])
@given(st.lists(turns, max_size=12))
def test_it_never_inflates_when_it_must_not(story: Story) -> None:
    bench = Bench(Firmware())
    bench.greet()
    start_full = bench.firmware.settings["dvp_full_duty"]
    lives_until_ms = -1
    told: list[Message] = []
    for messages, cv_kPa, reservoir_kPa, steps in story:
        for message in messages:
            if isinstance(message, bytes):
                # Ended by a zero byte, so that garbage does not join the next message.
                bench.firmware.receive(message + b"\x00")
                continue
            told += bench.answers()
            bench.send(message)
            answers = bench.answers()
            told += answers
            if isinstance(message, Setpoint) and not any(isinstance(answer, Refusal) for answer in answers):
                lives_until_ms = bench.now_ms - 1 + min(message.ttl_ms, 300)
        bench.cv_kPa, bench.reservoir_kPa = cv_kPa, reservoir_kPa
        for _ in range(steps):
            at_ms = bench.now_ms
            drive = bench.run(1)
            assert 0.0 <= drive.evp <= 1.0
            assert 0.0 <= drive.dvp <= 1.0
            assert not (drive.evp and drive.solenoid)
            assert drive.solenoid or not drive.dvp
            if bench.firmware.mode is not Mode.REGULATE or bench.firmware.faults or at_ms >= lives_until_ms:
                # With another full duty cycle than at the start, the Venturi's valve opens by another share.
                full = bench.firmware.settings["dvp_full_duty"]
                relief = RELIEF._replace(dvp=min(1.0, full / start_full))
                same = drive._replace(dvp=relief.dvp) == relief and abs(drive.dvp - relief.dvp) < 1e-3
                assert drive == SAFE or (same and Fault.CV_OVERPRESSURE in bench.firmware.faults)
        told += bench.answers()
    for answer in told:
        if isinstance(answer, Telemetry):
            assert math.isfinite(answer.cv_kPa)
            assert math.isfinite(answer.reservoir_kPa)
            assert math.isfinite(answer.setpoint_kPa)
