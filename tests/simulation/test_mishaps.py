"""Each simulated hardware fault has its described effect, and none creates or loses air."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from random import Random
from statistics import pstdev

import pytest
from closed_forms import choked_time_constant_s, isothermal_choked_discharge_kPa_abs
from random_mishaps import DRAWN, Mishap, Momentary, draw_mishap
from still_board import StillBoard

from firmware_link.protocol import PROTOCOL_VERSION, Codec, Hello, Mode, Setpoint, Telemetry, Vent
from flying_vines.physics.baseline import Inputs
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.flow import Ohm, flow_SL_per_s
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.plant.volume import Pouch, Wall
from flying_vines.physics.rig import ControlVolume, Rig, Sensors
from flying_vines.simulation.phlosar import mishaps
from flying_vines.simulation.phlosar.firmware import SAFE
from flying_vines.simulation.phlosar.mishaps import (
    PLACES,
    Blocked,
    Drifting,
    Filled,
    Gain,
    Glitching,
    Hanging,
    Heated,
    Hole,
    HoseOff,
    Kinked,
    MishapKind,
    Mishaps,
    Noisy,
    Open,
    Reset,
    SensorMishap,
    Shorted,
    Stuck,
    StuckAt,
    Unpowered,
    WatchdogReset,
)
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar

SHUT, INFLATING = Inputs(0.0, 0.0, False), Inputs(1.0, 0.0, False)
AMBIENT_KPA = 101.325
QUIET = Rig(sensors=Sensors(0.0, 0.0))
WARM = Effects(reservoir_wall=Wall(conductance_W_per_K=1.0), cv_wall=Wall(0.5), cv_shape=Pouch())
"""All effects that make it hard to separate a part, but no tubing."""

likely_and_ideal = pytest.mark.parametrize("effects", [None, Effects()], ids=["likely", "ideal"])
of_either_sensor = pytest.mark.parametrize(
    ("place", "column", "span_kPa"), [("cv_sensor", 1, 206.84), ("reservoir_sensor", 2, 1500.0)]
)


def rigged(
    drive: Inputs, effects: Effects | None = None, *, cv_kPa: float = 0.0, rig: Rig = QUIET
) -> tuple[SimulatedPhlosar, StillBoard]:
    """A phloSAR with constant valve commands, and the board that gives them."""
    board = StillBoard(drive)
    return SimulatedPhlosar(rig, board, effects=effects, cv_kPa=cv_kPa), board


def air_SL(phlosar: SimulatedPhlosar) -> float:
    state = phlosar.state
    return state.reservoir_air_SL + state.cv_air_SL + state.line_air_SL + state.vented_SL


# Sensors.


def read_with(
    place: str, column: int, kind: SensorMishap, *, seed: int = 1, rig: Rig = QUIET
) -> tuple[list[float], list[float]]:
    """The readings of a sensor in the half second after a mishap began, and the readings without it."""
    found = []
    for suffered in (kind, None):
        board = StillBoard(INFLATING)
        phlosar = SimulatedPhlosar(rig, board, effects=Effects(), seed=seed)
        phlosar.advance(0.1)
        phlosar.inject(place, suffered)
        phlosar.advance(0.6)
        found.append([step[column] for step in board.steps])
    broken, well = found
    assert broken[:101] == well[:101]
    assert well[100] != well[-1]
    return broken[101:], well[101:]


@of_either_sensor
def test_a_stuck_sensor_reads_what_it_read_last(place: str, column: int, span_kPa: float) -> None:
    broken, well = read_with(place, column, Stuck(), rig=Rig())
    assert len(set(broken)) == 1
    assert abs(broken[0] - well[0]) < 4.0
    assert broken[0] not in well


@of_either_sensor
@pytest.mark.parametrize(
    ("kind", "wrong_kPa"),
    [
        (Drifting(-4.0), lambda kPa, ms, span_kPa: kPa - 0.004 * (ms + 1)),
        # A wire carries no more than its supply.
        (Open(), lambda kPa, ms, span_kPa: -0.125 * span_kPa),
        (Shorted(), lambda kPa, ms, span_kPa: 1.125 * span_kPa),
        (Drifting(1e9), lambda kPa, ms, span_kPa: 1.125 * span_kPa),
        (Gain(0.8), lambda kPa, ms, span_kPa: 0.8 * kPa),
        (Gain(0.0), lambda kPa, ms, span_kPa: 0.0),
        (Glitching(77.0, every_ms=200.0), lambda kPa, ms, span_kPa: kPa if ms % 200 else 77.0),
    ],
    ids=lambda value: "reads" if inspect.isfunction(value) else repr(value),
)
def test_a_sensor_may_be_wrong(
    place: str, column: int, span_kPa: float, kind: SensorMishap, wrong_kPa: Callable[..., float]
) -> None:
    broken, well = read_with(place, column, kind)
    assert broken == pytest.approx([wrong_kPa(kPa, ms, span_kPa) for ms, kPa in enumerate(well)])


@of_either_sensor
def test_noise_comes_beside_what_there_is(place: str, column: int, span_kPa: float) -> None:
    broken, well = read_with(place, column, Noisy(3.0), rig=Rig())
    assert pstdev(a - b for a, b in zip(broken, well, strict=True)) == pytest.approx(3.0, rel=0.15)
    other, well_other = read_with(place, 3 - column, Noisy(3.0), rig=Rig())
    assert other == well_other
    assert broken == read_with(place, column, Noisy(3.0), rig=Rig())[0]
    assert broken != read_with(place, column, Noisy(3.0), rig=Rig(), seed=2)[0]


def test_both_may_be_wrong_at_once_and_well_again() -> None:
    phlosar, board = rigged(INFLATING, Effects())
    phlosar.mishaps.cv_sensor, phlosar.mishaps.reservoir_sensor = Open(), Gain(0.0)
    phlosar.advance(0.1)
    assert board.steps[-1][1:] == (-0.125 * 206.84, 0.0)
    phlosar.mishaps = Mishaps()
    phlosar.advance(0.2)
    assert board.steps[-1][1:] == (phlosar.cv_kPa, phlosar.reservoir_kPa)


# Valves.


EMPTYING = Inputs(0.0, 1.0, True)


@likely_and_ideal
@pytest.mark.parametrize(
    ("place", "opening", "commanded", "cv_kPa", "stuck", "mended"),
    [
        # Open: air comes in with any command. Afterwards the vine keeps it.
        ("evp", 1.0, SHUT, 0.0, lambda p: p.cv_kPa > 100.0, lambda p: p.cv_kPa > 100.0),
        ("evp", 0.0, INFLATING, 0.0, lambda p: abs(p.cv_kPa) < 1e-6, lambda p: p.cv_kPa > 20.0),
        # The Venturi spends air and pulls, or does not pull.
        ("dvp", 1.0, SAFE, 0.0, lambda p: p.cv_kPa < -20.0 and p.reservoir_kPa < 660.0,
         lambda p: abs(p.cv_kPa) < 1.0),
        ("dvp", 0.0, EMPTYING, 0.0, lambda p: abs(p.cv_kPa) < 0.1 and p.reservoir_kPa > 689.0,
         lambda p: p.cv_kPa < -20.0),
        ("solenoid", 0.0, SAFE, 20.0, lambda p: p.cv_kPa > 17.0, lambda p: p.cv_kPa < 1.0),
        ("solenoid", 1.0, SHUT, 20.0, lambda p: p.cv_kPa < 1.0, lambda p: p.cv_kPa < 1.0),
    ],
)  # fmt: skip
def test_a_valve_may_stick_open_or_shut(
    effects: Effects | None,
    place: str,
    opening: float,
    commanded: Inputs,
    cv_kPa: float,
    stuck: Callable[[SimulatedPhlosar], bool],
    mended: Callable[[SimulatedPhlosar], bool],
) -> None:
    phlosar, _ = rigged(commanded, effects, cv_kPa=cv_kPa)
    phlosar.inject(place, StuckAt(opening))
    phlosar.advance(1.0)
    assert stuck(phlosar)
    phlosar.inject(place, None)
    phlosar.advance(2.0)
    assert mended(phlosar)


@pytest.mark.parametrize("commanded", [SHUT, INFLATING])
def test_one_stuck_in_between_is_open_that_far_with_no_dead_zone(commanded: Inputs) -> None:
    phlosar, _ = rigged(commanded)
    phlosar.mishaps.evp = phlosar.mishaps.dvp = StuckAt(0.1)
    phlosar.advance(0.3)
    assert phlosar.state.evp_opening == pytest.approx(0.1)
    assert phlosar.state.dvp_opening == pytest.approx(0.1)


# Volumes.


@pytest.mark.parametrize("effects", [None, Effects(), WARM], ids=["likely", "ideal", "warm"])
@pytest.mark.parametrize("index", range(len(DRAWN)))
def test_no_air_is_made_or_lost(index: int, effects: Effects | None) -> None:
    place, make = DRAWN[index]
    phlosar, board = rigged(INFLATING, effects)
    all_SL = air_SL(phlosar)
    for commanded in (INFLATING, SHUT, SAFE, Inputs(0.0, 1.0, True), INFLATING):
        if commanded is SHUT:
            phlosar.inject(place, make(Random(index)))
        elif phlosar.now_s > 0.16:
            phlosar.inject(place, None)
        board.drive = commanded
        phlosar.advance(phlosar.now_s + 0.05)
        assert air_SL(phlosar) == pytest.approx(all_SL, rel=1e-12)
        assert phlosar.reservoir_kPa > -0.01
        assert -AMBIENT_KPA < phlosar.cv_kPa <= 690.0


@likely_and_ideal
@pytest.mark.parametrize("kind", [HoseOff(), Hole(6.0)])
def test_a_hose_that_comes_off_or_a_burst_empties_the_vine_and_it_is_not_fed(
    effects: Effects | None, kind: HoseOff | Hole
) -> None:
    phlosar, board = rigged(SHUT, effects, cv_kPa=20.0)
    phlosar.advance(0.1)
    assert phlosar.cv_kPa > 19.0
    phlosar.inject("hose" if isinstance(kind, HoseOff) else "actuator", kind)
    phlosar.advance(0.2)
    assert phlosar.cv_kPa < 0.5
    board.drive = INFLATING
    before_SL = phlosar.state.vented_SL
    phlosar.advance(1.0)
    # Air through the open valve leaves again, and the sensor at the valves shows hardly any of it.
    assert board.steps[-1][1] < 5.0
    assert phlosar.cv_kPa < 3.0
    assert phlosar.state.vented_SL - before_SL > 0.1


@pytest.mark.parametrize("own", [None, Ohm(20_000.0)])
def test_a_slow_leak_comes_beside_the_rigs_own(own: Ohm | None) -> None:
    phlosar, _ = rigged(SHUT, Effects(cv_leak=own), cv_kPa=20.0)
    phlosar.mishaps.actuator = Hole(0.1)
    phlosar.advance(0.1)
    leaks = (Hole(0.1).opening, *([own.numbers()] if own else []))
    out_SL_per_s = sum(flow_SL_per_s(leak, 20.0 + AMBIENT_KPA, AMBIENT_KPA, 1.0, 1.0) for leak in leaks)
    assert 20.0 - phlosar.cv_kPa == pytest.approx(0.1 * out_SL_per_s * AMBIENT_KPA / 0.1, rel=0.01)
    assert phlosar.state.vented_SL == pytest.approx(0.1 * out_SL_per_s, rel=0.01)


def test_a_hole_in_the_reservoir_empties_it_as_in_the_textbook() -> None:
    phlosar, _ = rigged(SHUT, Effects())
    phlosar.mishaps.reservoir = Hole(2.0)
    phlosar.advance(1.0)
    tau_s = choked_time_constant_s(2.0, Hole(2.0).opening.conductance_SL_per_s_kPa)
    left_kPa_abs = isothermal_choked_discharge_kPa_abs(690.0 + AMBIENT_KPA, 1.0, tau_s)
    assert phlosar.reservoir_kPa + AMBIENT_KPA == pytest.approx(left_kPa_abs, rel=1e-3)
    phlosar.mishaps.reservoir = None
    kept_kPa = phlosar.reservoir_kPa
    phlosar.advance(2.0)
    assert phlosar.reservoir_kPa == kept_kPa


def test_a_hole_has_the_flow_of_its_size() -> None:
    # 4 mm, of which 0.65 counts: 1.65 dm³/(s·bar), by p A √(γ/(R T)) (2/(γ+1))^3 over 1.185 kg/m³.
    dm3_per_s_bar = Hole(4.0).opening.conductance_SL_per_s_kPa * 101.325
    assert dm3_per_s_bar == pytest.approx(1.63, abs=0.03)


@likely_and_ideal
def test_a_kinked_hose_feeds_nothing_and_the_sensor_sees_the_valves_side(effects: Effects | None) -> None:
    phlosar, board = rigged(SHUT, effects, cv_kPa=10.0)
    phlosar.mishaps.hose = Kinked()
    phlosar.advance(0.02)
    before_kPa = phlosar.cv_kPa
    assert before_kPa == pytest.approx(10.0, rel=0.02)
    board.drive = INFLATING
    phlosar.advance(0.12)
    assert phlosar.cv_kPa == pytest.approx(before_kPa, rel=0.01)
    assert board.steps[-1][1] > 100.0
    board.drive = SAFE
    phlosar.advance(0.4)
    assert board.steps[-1][1] < 0.5
    assert phlosar.cv_kPa == pytest.approx(before_kPa, rel=0.02)
    phlosar.mishaps.hose = None
    phlosar.advance(1.0)
    assert phlosar.cv_kPa < 1.0


@likely_and_ideal
def test_half_a_kink_slows_it(effects: Effects | None) -> None:
    reached_SL = []
    for kind in (None, Kinked(2000.0), Kinked(10_000.0)):
        phlosar, _ = rigged(INFLATING, effects, rig=Rig(sensors=Sensors(0.0, 0.0)))
        phlosar.mishaps.hose = kind
        phlosar.advance(0.8)
        reached_SL.append(phlosar.state.cv_air_SL)
    assert reached_SL == sorted(reached_SL, reverse=True)
    assert reached_SL[2] < 0.8 * reached_SL[0]


@likely_and_ideal
def test_a_reservoir_may_be_filled_and_emptied(effects: Effects | None) -> None:
    phlosar, _ = rigged(SHUT, effects)
    phlosar.inject("reservoir", Filled(800.0))
    assert phlosar.reservoir_kPa == pytest.approx(800.0)
    phlosar.inject("reservoir", Filled(0.0))
    phlosar.advance(0.1)
    assert phlosar.reservoir_kPa == pytest.approx(0.0, abs=0.1)
    assert phlosar.mishaps == Mishaps()


@pytest.mark.parametrize("effects", [None, Effects(), WARM], ids=["likely", "ideal", "warm"])
def test_a_reservoir_in_the_sun_has_more_pressure(effects: Effects | None) -> None:
    phlosar, _ = rigged(SHUT, effects)
    phlosar.inject("reservoir", Heated(30.0))
    warm_kPa_abs = (690.0 + AMBIENT_KPA) * (1.0 + 30.0 / 293.15)
    assert phlosar.reservoir_kPa + AMBIENT_KPA == pytest.approx(warm_kPa_abs)
    phlosar.advance(5.0)
    # The likely reservoir's wall is as warm as its air; WARM's is at ambient, the ideal one has none.
    left = (phlosar.reservoir_kPa + AMBIENT_KPA - 791.325) / (warm_kPa_abs - 791.325)
    assert left == pytest.approx({None: 0.96, Effects(): 1.0, WARM: 0.69}[effects], abs=0.03)


# The board.


def greeted(phlosar: SimulatedPhlosar, target_kPa: float = 20.0) -> Codec:
    host = Codec()
    phlosar.receive(host.encode(Hello(PROTOCOL_VERSION, 1)))
    hold(phlosar, host, 0.8, target_kPa)
    return host


def hold(phlosar: SimulatedPhlosar, host: Codec, seconds: float, target_kPa: float = 20.0) -> bytes:
    sent = b""
    for _ in range(round(seconds * 50)):
        phlosar.receive(host.encode(Setpoint(target_kPa, 60.0, 250, 1)))
        told = phlosar.advance(phlosar.now_s + 0.02)
        host.decode(told)
        sent += told
    return sent


def test_a_board_without_power_does_not_communicate_and_its_valves_shut() -> None:
    phlosar = SimulatedPhlosar(effects=Effects())
    host = greeted(phlosar)
    phlosar.mishaps.board = Unpowered()
    before_kPa = phlosar.cv_kPa
    assert hold(phlosar, host, 1.0) == b""
    assert phlosar.drive == SHUT
    # Its outlet needs power to open, so the vine keeps its air.
    assert phlosar.cv_kPa == pytest.approx(before_kPa, abs=0.01) == pytest.approx(20.0, abs=0.5)
    phlosar.mishaps.board = None
    sent = phlosar.advance(phlosar.now_s + 0.5)
    first = next(message for message in Codec().decode(sent) if isinstance(message, Telemetry))
    assert first.device_time_ms < 10
    assert phlosar.firmware.mode is Mode.VENT
    assert phlosar.firmware.number == 0
    assert phlosar.cv_kPa < 1.0


def test_a_hanging_board_keeps_its_valves_until_the_watchdog_resets_it() -> None:
    board = StillBoard(INFLATING)
    phlosar = SimulatedPhlosar(QUIET, board, effects=Effects())
    phlosar.advance(0.1)
    phlosar.mishaps.board = Hanging()
    board.drive = SAFE
    phlosar.receive(b"vent!")
    phlosar.advance(0.355)
    assert board.received == b""
    assert board.resets == []
    assert len(board.steps) == 101
    assert phlosar.drive == INFLATING
    phlosar.advance(0.356)
    assert board.resets == [True]
    assert phlosar.drive == SAFE
    assert phlosar.mishaps.board is None
    phlosar.receive(b"vent!")
    assert board.received == b"vent!"


def test_a_board_that_hangs_for_a_moment_goes_on() -> None:
    phlosar, board = rigged(SHUT, Effects())
    phlosar.advance(0.1)
    phlosar.inject("board", Hanging())
    phlosar.advance(0.2)
    phlosar.inject("board", None)
    phlosar.advance(1.0)
    assert board.resets == []
    assert len(board.steps) == 1001 - 100


@pytest.mark.parametrize(("kind", "watchdog"), [(Reset(), False), (WatchdogReset(), True)])
def test_a_reset_is_over_at_once(kind: MishapKind, watchdog: bool) -> None:
    phlosar, board = rigged(SHUT, Effects())
    phlosar.advance(0.1)
    phlosar.inject("board", kind)
    phlosar.advance(1.0)
    assert board.resets == [watchdog]
    assert phlosar.mishaps == Mishaps()


def test_without_a_fault_the_run_is_the_same_to_the_last_bit() -> None:
    def flown(mishap: MishapKind | None) -> tuple[bytes, float]:
        phlosar = SimulatedPhlosar()
        host = greeted(phlosar)
        phlosar.inject("evp", mishap)
        phlosar.inject("evp", None)
        return hold(phlosar, host, 0.2), phlosar.cv_kPa

    assert flown(StuckAt(1.0)) == flown(None)


def test_draws_repeat_themselves_and_print_as_what_makes_them() -> None:
    def draws(seed: int) -> list[Mishap]:
        random = Random(seed)
        return [draw_mishap(random, 30.0) for _ in range(400)]

    drawn = draws(1)
    assert drawn == draws(1) != draws(2)
    assert [eval(repr(mishap.kind), vars(mishaps)) for mishap in drawn] == [m.kind for m in drawn]
    assert all(0.0 <= mishap.begins_s <= 30.0 for mishap in drawn)
    assert all(m.ends_s is None for m in drawn if isinstance(m.kind, Momentary))
    assert 100 < sum(mishap.ends_s is not None for mishap in drawn) < 250
    everything = {(place, kind) for place, kinds in PLACES.items() for kind in kinds.values()}
    # Not drawn: in the campaign's flights it would take another mishap's place.
    assert {(mishap.place, type(mishap.kind)) for mishap in drawn} == everything - {("venturi", Blocked)}


@pytest.mark.parametrize("seed", range(8))
def test_a_flight_survives_several_at_once(seed: int) -> None:
    random = Random(seed)
    phlosar = SimulatedPhlosar(
        Rig(cv=ControlVolume(random.choice([0.1, 0.5, 1.0]))), effects=Effects(), seed=seed
    )
    all_SL = air_SL(phlosar)
    planned = [draw_mishap(random, 3.0) for _ in range(5)]
    host = Codec()
    for step in range(150):
        for mishap in planned:
            if step == round(mishap.begins_s / 0.02):
                phlosar.inject(mishap.place, mishap.kind)
            if mishap.ends_s is not None and step == round(mishap.ends_s / 0.02):
                phlosar.inject(mishap.place, None)
        if step % 40 == 0:
            phlosar.receive(host.encode(Hello(PROTOCOL_VERSION, step)))
        phlosar.receive(
            host.encode(Vent(step + 1) if step % 60 > 40 else Setpoint(20.0, 60.0, 250, step + 1))
        )
        host.decode(phlosar.advance(0.02 * (step + 1)))
        assert air_SL(phlosar) == pytest.approx(all_SL, rel=1e-12)
        assert -AMBIENT_KPA < phlosar.cv_kPa < 900.0


def test_a_rig_without_a_vine_has_nothing_to_burst() -> None:
    phlosar = SimulatedPhlosar(TrueRig(Rig(cv=None)), StillBoard(SHUT))
    all_SL = air_SL(phlosar)
    phlosar.mishaps.hose, phlosar.mishaps.actuator = Kinked(), Hole(5.0)
    phlosar.advance(0.1)
    assert phlosar.cv_kPa == 0.0
    assert air_SL(phlosar) == pytest.approx(all_SL, rel=1e-12)


@pytest.mark.parametrize(
    ("place", "kind", "sentence"),
    [
        ("wing", Stuck(), "wing is not a place"),
        ("evp", Stuck(), r"evp cannot have Stuck\(\)"),
        ("reservoir", HoseOff(), r"reservoir cannot have HoseOff\(\)"),
    ],
)
def test_a_fault_at_an_impossible_place_is_refused(place: str, kind: MishapKind, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        SimulatedPhlosar(effects=Effects()).inject(place, kind)


def test_impossible_numbers_are_refused() -> None:
    for make in (
        lambda: StuckAt(1.1),
        lambda: Hole(0.0),
        lambda: Kinked(-1.0),
        lambda: Noisy(-1.0),
        lambda: Glitching(0.0, 0.5),
        lambda: Filled(-1.0),
        lambda: Heated(-200.0),
    ):
        with pytest.raises(ValueError, match=r"^[a-z]"):
            make()
