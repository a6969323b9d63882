"""The physics checks are silent on healthy rigs, and each one finds its fault in time."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable, Iterator, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import examples
from firmware_link import protocol
from firmware_link.protocol import PROTOCOL_VERSION, Fault, Hello, Mode, Setpoint, Telemetry, Vent
from flying_vines.config.config import ChecksConfig, PneumaticsConfig
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.mishaps import (
    Drifting,
    Filled,
    Gain,
    Glitching,
    Hole,
    HoseOff,
    MishapKind,
    Noisy,
    Stuck,
    StuckAt,
)
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.supply import RigPrior, TelemetryReader, nominal
from flying_vines.supply.physics_checks import CHECKS, PhysicsChecks, PhysicsFinding

HOST_TICK_S = 0.02
TOP_KPA = 20.0
RATE_KPA_PER_S = 60.0

Found = list[tuple[float, PhysicsFinding]]


class Watch(PhysicsChecks):
    """The checks and the reader before them, as in the core."""

    def __init__(self, prior: RigPrior, checks: ChecksConfig) -> None:
        super().__init__(prior, checks)
        self._reader = TelemetryReader(prior)

    def watch(self, telemetry: Telemetry) -> list[PhysicsFinding]:
        return self.take(self._reader.read(telemetry.device_time_ms / 1000.0, telemetry))


def checks_of(cv_volume_L: float = 0.1, checks: ChecksConfig | None = None) -> Watch:
    return Watch(nominal(PneumaticsConfig(cv_volume_L=cv_volume_L)), checks or ChecksConfig())


class Flying:
    """A simulated phloSAR with setpoints, and the checks."""

    def __init__(
        self, phlosar: SimulatedPhlosar, checks: Watch, lost: Callable[[], bool] = lambda: False
    ) -> None:
        self.phlosar = phlosar
        self._lost = lost
        self.checks = checks
        self.found: Found = []
        self._codec = protocol.Codec()
        self._tick = 0
        phlosar.receive(self._codec.encode(Hello(PROTOCOL_VERSION, 1)))

    def run(self, seconds: float, target_kPa: float | None) -> Found:
        """The findings in this time, while regulating to a pressure, or vented."""
        before = len(self.found)
        for _ in range(round(seconds / HOST_TICK_S)):
            self._tick += 1
            number = self._tick & 0xFFFF
            command = (
                Vent(number) if target_kPa is None else Setpoint(target_kPa, RATE_KPA_PER_S, 250, number)
            )
            self.phlosar.receive(self._codec.encode(command))
            now_s = self._tick * HOST_TICK_S
            for message in self._codec.decode(self.phlosar.advance(now_s)):
                if isinstance(message, Telemetry) and not self._lost():
                    self.found += [(now_s, finding) for finding in self.checks.watch(message)]
        return self.found[before:]


def likely(cv_volume_L: float = 0.1, reservoir_kPa: float = 690.0) -> SimulatedPhlosar:
    return SimulatedPhlosar(Rig(cv=ControlVolume(cv_volume_L)), reservoir_kPa=reservoir_kPa)


@pytest.mark.parametrize("believed_share", [0.5, pytest.param(1.0, marks=pytest.mark.long), 2.0])
@pytest.mark.parametrize(("cv_volume_L", "reservoir_kPa"), [(0.05, 690.0), (0.1, 120.0), (1.0, 600.0)])
def test_a_healthy_rig_has_no_false_fault(
    cv_volume_L: float, reservoir_kPa: float, believed_share: float
) -> None:
    flying = Flying(likely(cv_volume_L, reservoir_kPa), checks_of(believed_share * cv_volume_L))
    flying.run(2.0, None)
    for target_kPa in (TOP_KPA, 8.0, TOP_KPA, 0.0, TOP_KPA, None):
        flying.run(1.5, target_kPa)
    assert flying.found == []


REST, BEND, HOLD, RELEASE = "rest", "bend", "hold", "release"

MISHAPS: Sequence[tuple[str, MishapKind, str, str, float]] = (
    # Place, mishap, phase of the flight, the check that finds it, maximum time in s.
    ("evp", StuckAt(0.0), BEND, "filling", 2.0),
    ("hose", HoseOff(), BEND, "filling", 2.0),
    ("cv_sensor", Stuck(), BEND, "vine_sensor", 0.6),
    ("actuator", Hole(4.0), HOLD, "filling", 0.8),
    ("cv_sensor", Gain(0.0), HOLD, "filling", 0.8),
    ("solenoid", StuckAt(0.0), RELEASE, "venting", 3.0),
    ("evp", StuckAt(1.0), REST, "reservoir_loss", 1.5),
    ("dvp", StuckAt(1.0), HOLD, "reservoir_loss", 1.5),
    ("reservoir", Hole(4.0), HOLD, "reservoir_loss", 0.6),
    ("cv_sensor", Drifting(-1.0), REST, "vine_zero", 5.5),
    ("cv_sensor", Noisy(5.0), REST, "unsteady", 1.0),
    ("reservoir_sensor", Noisy(20.0), REST, "unsteady", 1.5),
    ("reservoir", Filled(750.0), REST, "reservoir_hot", 1.5),
    ("actuator", Hole(0.6), HOLD, "vine_leak", 10.0),
)


@pytest.mark.parametrize(("place", "kind", "when", "name", "within_s"), MISHAPS)
def test_a_mishap_is_found_in_time(
    place: str, kind: MishapKind, when: str, name: str, within_s: float
) -> None:
    flying = Flying(likely(), checks_of())
    flying.run(8.0 if name == "vine_leak" else 2.0, None)  # only this check compares a hold with a rest
    if when in (HOLD, RELEASE):
        flying.run(1.5, TOP_KPA)
    assert flying.found == []
    flying.phlosar.inject(place, kind)
    found = flying.run(within_s, None if when in (REST, RELEASE) else TOP_KPA)
    assert name in [finding.name for _, finding in found]


def flying_at_10_Hz(seed: int, loses: float, cv_volume_L: float = 0.1) -> Flying:
    """Telemetry at 10 Hz, of which this share is lost."""
    chance = random.Random(seed)
    rig, settings = Rig(cv=ControlVolume(cv_volume_L)), {"telemetry_Hz": 10}
    return Flying(
        SimulatedPhlosar(rig, settings, seed=seed), checks_of(cv_volume_L), lambda: chance.random() < loses
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_hose_off_is_found_within_1_s_at_10_Hz_of_which_a_fifth_is_lost(seed: int) -> None:
    flying = flying_at_10_Hz(seed, 0.2)
    flying.run(2.0, None)
    flying.run(1.4 + 0.02 * seed, TOP_KPA)
    assert flying.found == []
    flying.phlosar.inject("hose", HoseOff())
    assert "filling" in [finding.name for _, finding in flying.run(1.0, TOP_KPA)]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2, 3))])
def test_a_hose_off_before_the_bend_is_found_at_10_Hz_nearly_as_soon_as_at_100_Hz(seed: int) -> None:
    found_s = []
    for flying in (Flying(SimulatedPhlosar(seed=seed), checks_of()), flying_at_10_Hz(seed, 0.2)):
        flying.run(2.0, None)
        flying.phlosar.inject("hose", HoseOff())
        found_s.append(next(at_s for at_s, finding in flying.run(4.0, TOP_KPA) if finding.level == "fault"))
    assert found_s[1] <= found_s[0] + 1.0


@pytest.mark.parametrize(
    "loses", [*(pytest.param(share, marks=pytest.mark.long) for share in (0.0, 0.2)), 0.5]
)
@pytest.mark.parametrize("cv_volume_L", [pytest.param(0.05, marks=pytest.mark.long), 0.3])
def test_a_healthy_rig_has_no_false_fault_with_telemetry_of_10_Hz(cv_volume_L: float, loses: float) -> None:
    flying = flying_at_10_Hz(1, loses, cv_volume_L)
    flying.run(2.0, None)
    for target_kPa in (TOP_KPA, 8.0, TOP_KPA, 0.0, TOP_KPA, None) * 2:
        flying.run(1.5, target_kPa)
    assert flying.found == []


def test_readings_that_are_the_same_by_chance_are_no_stuck_sensor() -> None:
    """Three equal readings at 10 Hz take 0.2 s."""
    checks = checks_of()
    opening = dataclasses.replace(HELD, setpoint_kPa=19.0, evp_opening=0.7)
    messages = [
        dataclasses.replace(opening, cv_kPa=18.0 + 0.1 * (i // 4), device_time_ms=100 * i) for i in range(8)
    ]
    assert [finding.name for message in messages for finding in checks.watch(message)] == []


def test_a_reservoir_sensor_that_is_stuck_is_found_within_eight_bends() -> None:
    flying = Flying(likely(), checks_of())
    flying.run(2.0, None)
    flying.phlosar.mishaps.reservoir_sensor = Stuck()
    for _ in range(8):
        flying.run(1.0, TOP_KPA)
        flying.run(1.0, None)
    ((at_s, finding),) = flying.found
    assert (finding.name, finding.level) == ("reservoir_sensor", "warn")
    assert at_s > 4.0, "one bend of this vine moves the reservoir by less than its sensor tells apart"


def test_the_sentence_names_where_the_air_went() -> None:
    for place, kind, sentence in (
        ("evp", StuckAt(0.0), "not filling, reservoir loses no air: valve"),
        ("hose", HoseOff(), "not filling, air is lost: hose or actuator"),
    ):
        flying = Flying(likely(0.3), checks_of(0.3))
        flying.run(1.0, None)
        flying.phlosar.inject(place, kind)
        assert flying.run(6.0, TOP_KPA)[0][1].sentence == sentence


def test_an_inflation_valve_stuck_open_is_distinguished_from_a_shut_outlet() -> None:
    sentences: dict[str, str] = {}
    for place, kind in (("evp", StuckAt(1.0)), ("solenoid", StuckAt(0.0))):
        flying = Flying(likely(0.3, 300.0), checks_of(0.3))
        flying.run(1.0, None)
        flying.run(3.0, TOP_KPA)
        flying.phlosar.inject(place, kind)
        found = [finding for _, finding in flying.run(4.0, None)]
        sentences[place] = next(finding.sentence for finding in found if finding.name == "venting")
    assert sentences["evp"] == "not venting, valve stuck open: close the reservoir"
    assert sentences["solenoid"] == "not venting: outlet, line or sensor"


def test_glitches_of_single_readings_are_no_fault() -> None:
    flying = Flying(likely(), checks_of())
    flying.phlosar.mishaps.cv_sensor = Glitching(60.0, every_ms=490.0)
    for target_kPa in (None, TOP_KPA, 10.0, TOP_KPA, None):
        flying.run(1.5, target_kPa)
    assert [finding for _, finding in flying.found if finding.level == "fault"] == []


# Handmade telemetry, faster than any rig.

VENTED = Telemetry(0, Mode.VENT, Fault.NONE, 0, 0.0, 0.0, 600.0, 0.0, 0.0, True)
HELD = dataclasses.replace(VENTED, mode=Mode.REGULATE, setpoint_kPa=20.0, cv_kPa=20.0, solenoid=False)


def stream(
    checks: Watch, telemetry_at: Callable[[float], Telemetry], seconds: float, from_ms: int = 0
) -> Iterator[tuple[float, PhysicsFinding]]:
    """The findings in telemetry at 100 Hz; `telemetry_at` gives it by time in s."""
    for ms in range(0, round(1000 * seconds), 10):
        message = dataclasses.replace(telemetry_at(ms / 1000.0), device_time_ms=(from_ms + ms) & 0xFFFFFFFF)
        for finding in checks.watch(message):
            yield ms / 1000.0, finding


def test_a_burst_between_two_readings() -> None:
    def telemetry_at(t: float) -> Telemetry:
        return HELD if t < 1.0 else dataclasses.replace(HELD, cv_kPa=2.0)

    ((at_s, finding),) = stream(checks_of(), telemetry_at, 2.0)
    assert finding.name == "sudden_fall"
    assert "18 kPa at once" in finding.sentence
    assert at_s <= 1.05


def test_a_fall_while_the_setpoint_falls_is_none() -> None:
    def telemetry_at(t: float) -> Telemetry:
        lower = dataclasses.replace(HELD, setpoint_kPa=20.0 - t)
        return lower if t < 1.0 else dataclasses.replace(lower, cv_kPa=8.0)

    assert list(stream(checks_of(), telemetry_at, 2.0)) == []


@pytest.mark.parametrize(("offset_kPa", "within_s"), [(4.6, 6.5), (-4.6, 2.0)])
def test_the_zero_of_the_vine_sensor(offset_kPa: float, within_s: float) -> None:
    off = dataclasses.replace(VENTED, cv_kPa=offset_kPa)
    checks = checks_of()
    ((at_s, finding),) = stream(checks, lambda _: off, 10.0)
    assert (finding.name, finding.level) == ("vine_zero", "fault")
    assert at_s <= within_s
    assert f"{offset_kPa:.1f} kPa" in finding.sentence
    assert checks.faults == {"vine_zero": finding.sentence}
    list(stream(checks, lambda _: VENTED, 5.0, 10_000))
    assert checks.faults == {}


def regulating(setpoint_kPa: float, cv_kPa: float, **others: float) -> Callable[[float], Telemetry]:
    telemetry = dataclasses.replace(HELD, setpoint_kPa=setpoint_kPa, cv_kPa=cv_kPa, **others)  # type: ignore[arg-type]
    return lambda _: telemetry


@pytest.mark.parametrize(("reservoir_kPa", "within_s"), [(600.0, 2.1), (150.0, 5.0), (70.0, 11.0)])
def test_below_the_setpoint_counts_the_air_that_could_go_in(reservoir_kPa: float, within_s: float) -> None:
    low = regulating(20.0, 5.0, reservoir_kPa=reservoir_kPa)
    ((at_s, finding),) = stream(checks_of(), low, 20.0)
    assert (finding.name, finding.level) == ("below_setpoint", "warn")
    assert 0.6 * within_s <= at_s <= within_s


def test_an_empty_reservoir_could_fill_nothing_so_the_vine_is_not_reported() -> None:
    assert list(stream(checks_of(), regulating(20.0, 0.0, reservoir_kPa=20.0), 30.0)) == []


@pytest.mark.parametrize("cv_kPa", [18.1, 21.9])
def test_a_vine_near_its_setpoint_is_no_finding(cv_kPa: float) -> None:
    assert list(stream(checks_of(), regulating(20.0, cv_kPa), 30.0)) == []


@pytest.mark.parametrize(("setpoint_kPa", "cv_kPa"), [(3.9, -0.5), (0.0, 5.9), (3.9, 5.9)])
def test_at_a_low_setpoint_the_sensors_zero_is_no_finding(setpoint_kPa: float, cv_kPa: float) -> None:
    assert list(stream(checks_of(), regulating(setpoint_kPa, cv_kPa), 30.0)) == []


def test_far_above_the_setpoint_the_vine_must_lose_a_quarter_in_time() -> None:
    ((at_s, finding),) = stream(checks_of(), regulating(20.0, 24.0), 5.0)
    assert (finding.name, finding.level) == ("above_setpoint", "fault")
    assert 0.8 <= at_s <= 1.1

    def falling(t: float) -> Telemetry:
        return dataclasses.replace(HELD, setpoint_kPa=1.0, cv_kPa=24.0 * 0.75 ** (t / 0.9))

    assert list(stream(checks_of(), falling, 4.0)) == []


@pytest.mark.parametrize("setpoint_kPa", [20.0, 10.0])
def test_while_the_board_vents_no_setpoint_is_missed(setpoint_kPa: float) -> None:
    def telemetry_at(t: float) -> Telemetry:
        return dataclasses.replace(
            VENTED, mode=Mode.FAULT, setpoint_kPa=setpoint_kPa, cv_kPa=15.0 * 0.5**t, evp_opening=0.0
        )

    assert list(stream(checks_of(), telemetry_at, 5.0)) == []


def test_readings_of_a_good_sensor_are_no_fault() -> None:
    for offset_kPa in (-3.1, 3.1):
        off = dataclasses.replace(VENTED, cv_kPa=offset_kPa)
        assert list(stream(checks_of(), lambda _, off=off: off, 20.0)) == []  # type: ignore[misc]


def test_a_check_can_be_set_to_warn_and_is_counted() -> None:
    checks = checks_of(checks=ChecksConfig(vine_zero="warn"))
    off = dataclasses.replace(VENTED, cv_kPa=5.0)
    ((_, finding),) = stream(checks, lambda _: off, 10.0)
    assert finding.level == "warn"
    assert checks.faults == {}
    assert checks.counts == {"vine_zero": 1}


def test_a_gap_or_another_boot_starts_again() -> None:
    checks = checks_of()
    blocked = dataclasses.replace(VENTED, cv_kPa=20.0)
    assert [f.name for _, f in stream(checks, lambda _: blocked, 3.0)] == ["venting"]
    # Nobody knows if the outlet was open in the gap.
    assert list(stream(checks, lambda _: blocked, 0.5, 3_200)) == []
    assert checks.faults == {}
    assert list(stream(checks, lambda _: blocked, 0.5, 0)) == []
    assert checks.faults == {}


def test_the_devices_clock_may_wrap() -> None:
    blocked = dataclasses.replace(VENTED, cv_kPa=20.0)
    found = list(stream(checks_of(), lambda _: blocked, 3.0, (1 << 32) - 500))
    assert [finding.name for _, finding in found] == ["venting"]


def test_readings_that_the_firmware_refuses_give_no_finding() -> None:
    blind = dataclasses.replace(VENTED, mode=Mode.FAULT, faults=Fault.CV_SENSOR, cv_kPa=20.0)
    assert list(stream(checks_of(), lambda _: blind, 5.0)) == []


def test_every_check_has_a_level_in_the_configuration() -> None:
    assert set(CHECKS) == {
        name
        for name in ChecksConfig.__struct_fields__
        if name != "own" and not name.endswith(("kPa", "factor"))
    }


TOLD = st.builds(
    Telemetry,
    device_time_ms=st.just(0),
    mode=st.sampled_from(Mode),
    faults=st.just(Fault.NONE),
    number=st.just(0),
    setpoint_kPa=st.floats(0, 28),
    cv_kPa=st.floats(-20, 220),
    reservoir_kPa=st.floats(-100, 1100),
    evp_opening=st.floats(0, 1),
    dvp_opening=st.floats(0, 1),
    solenoid=st.booleans(),
)


@given(st.lists(st.tuples(TOLD, st.integers(0, 150)), max_size=120))
@settings(max_examples=examples(60), deadline=None)
def test_any_telemetry_is_taken(messages: list[tuple[Telemetry, int]]) -> None:
    checks = checks_of()
    at_ms = 0
    for message, later_ms in messages:
        at_ms += later_ms
        begun = checks.watch(dataclasses.replace(message, device_time_ms=at_ms))
        assert all(checks.present[finding.name] == finding for finding in begun)
        assert all(finding.sentence.isprintable() for finding in begun)


def test_the_ideal_plant_is_healthy_too() -> None:
    flying = Flying(SimulatedPhlosar(effects=Effects()), checks_of())
    for target_kPa in (None, TOP_KPA, 5.0, None, TOP_KPA, None):
        flying.run(3.0, target_kPa)
    assert flying.found == []
