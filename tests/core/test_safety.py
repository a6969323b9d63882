"""Safety without the rest of the core: interlocks, limits, losses and latched faults."""

from __future__ import annotations

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.protocol import Fault
from flying_vines.config import config
from flying_vines.config.config import Config
from flying_vines.core.safety import LossEnded, ResponseNeeded, Safety, SafetyInputs
from flying_vines.supply import AirNeeded
from flying_vines.vine.motion import plan
from flying_vines.vine.profile import Step

FLYING = SafetyInputs(
    armed=True,
    altitude_m=10.0,
    autopilot_age_s=0.2,
    firmware_ready=True,
    firmware_was_ready=True,
    telemetry_age_s=0.01,
    cv_kPa=0.0,
    reservoir_kPa=600.0,
)
BENT = FLYING._replace(moving=True, moving_s=5.0, cv_kPa=20.0)
CURVE = config.default().vine.bend_curve()
BEND = plan([Step(to_kPa=20.0)], CURVE, 0.0, 60.0, 20.7)
RELEASE = plan([Step(to_kPa=0.0)], CURVE, 20.0, 60.0, 20.7)
AIR = AirNeeded(spending_kPa=5.0, floor_kPa=120.0)


def safety(**tables: object) -> Safety:
    base: Config = config.default()
    return Safety(msgspec.structs.replace(base, **tables))


def but(conditions: SafetyInputs, **changes: object) -> SafetyInputs:
    return conditions._replace(**changes)  # type: ignore[arg-type]


def test_a_good_flight_bends() -> None:
    machine = safety()
    assert machine.watch(0.0, FLYING) == []
    assert machine.judge(BEND, AIR, FLYING).verdict == "accepted"


LOSSES: dict[str, dict[str, object]] = {
    "rc": {"rc_problem": "no RC_CHANNELS for 1 s"},
    "autopilot": {"autopilot_age_s": 3.1},
    "conflict": {"conflict": "two autopilots with id 1"},
    "serial": {"firmware_ready": False},
    "telemetry": {"telemetry_age_s": 0.31},
    "firmware_fault": {"faults": Fault.DEAD_MAN},
}


def test_a_board_that_never_answered_is_no_loss() -> None:
    machine = safety()
    assert machine.watch(0.0, but(FLYING, firmware_ready=False, firmware_was_ready=False)) == []


def test_a_second_firmware_fault_is_told_and_repeats_no_other_loss() -> None:
    machine = safety()
    lost = but(BENT, rc_problem="no RC_CHANNELS for 1 s", faults=Fault.DEAD_MAN)
    assert {change.name for change in machine.watch(1.0, lost)} == {"rc", "firmware_fault"}
    more = but(lost, faults=Fault.DEAD_MAN | Fault.CV_SENSOR)
    assert [change.name for change in machine.watch(2.0, more)] == ["firmware_fault"]


@pytest.mark.parametrize("name", LOSSES)
def test_each_loss_vents_once_refuses_and_ends(name: str) -> None:
    machine = safety()
    lost = but(BENT, **LOSSES[name])
    (entered,) = machine.watch(1.0, lost)
    assert isinstance(entered, ResponseNeeded)
    assert (entered.name, entered.response) == (name, "vent")
    assert entered.reason
    assert machine.watch(2.0, lost) == []
    ruling = machine.judge(BEND, AIR, lost)
    assert ruling.verdict == "refused"
    assert entered.reason in ruling.reason
    assert machine.judge(RELEASE, AIR, lost).verdict == "accepted"
    assert machine.watch(3.0, FLYING) == [LossEnded(name)]
    assert machine.judge(BEND, AIR, FLYING).verdict == "accepted"


def test_telemetry_of_unknown_age_is_stale() -> None:
    machine = safety()
    assert machine.judge(BEND, AIR, but(FLYING, telemetry_age_s=math.inf)).verdict == "refused"
    assert machine.judge(BEND, AIR, but(FLYING, telemetry_age_s=math.nan)).verdict == "refused"


LIMITS: dict[str, dict[str, object]] = {
    "reservoir": {"reservoir_kPa": 39.0},
    "disarmed": {"armed": False},
    "altitude": {"altitude_m": 1.4},
    "duration": {"moving_s": 121.0},
}


@pytest.mark.parametrize("name", LIMITS)
def test_each_limit_vents_a_bent_vine_once(name: str) -> None:
    machine = safety()
    (entered,) = machine.watch(1.0, but(BENT, **LIMITS[name]))
    assert isinstance(entered, ResponseNeeded)
    assert (entered.name, entered.response) == (name, "vent")
    vented = but(FLYING, **LIMITS[name])
    assert machine.watch(1.1, vented) == []
    assert machine.reasons == {}


def test_a_lost_altitude_vents_a_bent_vine() -> None:
    (entered,) = safety().watch(1.0, but(BENT, altitude_m=None))
    assert isinstance(entered, ResponseNeeded)
    assert entered.name == "altitude"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"armed": False}, "not armed"),
        ({"altitude_m": None}, "altitude not known"),
        ({"altitude_m": 1.9}, "below 2 m"),
        ({"autopilot_age_s": None}, "no autopilot"),
        ({"firmware_ready": False, "firmware_was_ready": False}, "not connected"),
        ({"reservoir_kPa": 64.0}, "reservoir at 64 kPa, needs 65"),
        ({"reservoir_kPa": math.nan}, "reservoir at nan"),
    ],
)
def test_interlocks_refuse_with_a_reason(change: dict[str, object], reason: str) -> None:
    machine = safety()
    now = but(FLYING, **change)
    machine.watch(0.0, now)
    ruling = machine.judge(BEND, AIR, now)
    assert ruling.verdict == "refused"
    assert reason in ruling.reason


def test_bench_mode_needs_no_flight() -> None:
    machine = safety(interlocks=config.InterlocksConfig(bench_mode=True))
    bench = but(FLYING, armed=False, altitude_m=None, autopilot_age_s=None)
    machine.watch(0.0, bench)
    assert machine.judge(BEND, AIR, bench).verdict == "accepted"
    assert machine.watch(0.1, but(bench, moving=True)) == []


def test_a_weak_reservoir_bends_slower() -> None:
    ruling = safety().judge(BEND, AIR, but(FLYING, reservoir_kPa=80.0))
    assert ruling.verdict == "limited"
    assert ruling.rate_scale == pytest.approx((80.0 - 20.0) / 120.0)


def test_overpressure_latches_until_a_person_clears_it_and_it_is_gone() -> None:
    machine = safety()
    high = but(BENT, cv_kPa=25.5)
    (entered,) = machine.watch(0.0, high)
    assert isinstance(entered, ResponseNeeded)
    assert entered.name == "overpressure"
    assert machine.clear(high) == {}
    assert machine.watch(1.0, FLYING) == []
    assert machine.judge(BEND, AIR, FLYING).verdict == "refused"
    assert list(machine.clear(FLYING)) == ["overpressure"]
    assert machine.judge(BEND, AIR, FLYING).verdict == "accepted"


def test_a_physics_check_latches_until_a_person_clears_it_and_it_is_over() -> None:
    machine = safety()
    wrong = but(BENT, physics={"venting": "not venting: outlet, line or sensor"})
    (entered,) = machine.watch(0.0, wrong)
    assert entered == ResponseNeeded("venting", "not venting: outlet, line or sensor", "vent")
    assert machine.watch(0.1, wrong) == []
    assert machine.clear(wrong) == {}
    assert machine.watch(1.0, FLYING) == []
    ruling = machine.judge(BEND, AIR, FLYING)
    assert (ruling.verdict, ruling.reason) == ("refused", "not venting: outlet, line or sensor")
    assert machine.judge(RELEASE, AIR, FLYING).verdict == "accepted"
    assert machine.clear(FLYING) == {"venting": "not venting: outlet, line or sensor"}
    assert machine.judge(BEND, AIR, FLYING).verdict == "accepted"


def test_hold_ends_in_venting() -> None:
    losses = config.LossesConfig(on_rc_loss="hold", hold_at_most_s=30.0)
    machine = safety(losses=losses)
    lost = but(BENT, rc_problem="silent")
    (entered,) = machine.watch(0.0, lost)
    assert isinstance(entered, ResponseNeeded)
    assert entered.response == "hold"
    machine.watch(20.0, lost)
    machine.triggered()  # letting some air out is no reason to hold the rest for longer
    assert machine.watch(29.9, lost) == []
    (entered,) = machine.watch(30.1, lost)
    assert isinstance(entered, ResponseNeeded)
    assert entered.response == "vent"
    assert machine.watch(40.0, lost) == []


def test_repeated_losses_are_not_held_longer_than_one_loss() -> None:
    machine = safety(losses=config.LossesConfig(on_rc_loss="hold", hold_at_most_s=5.0))
    lost = but(BENT, rc_problem="silent")
    for second in range(0, 8, 2):
        (entered,) = machine.watch(float(second), lost)
        assert isinstance(entered, ResponseNeeded) and entered.response == "hold"
        (left,) = machine.watch(second + 1.0, BENT)
        assert left == LossEnded("rc")
    # Four of the five seconds are used up.
    machine.watch(8.0, lost)
    assert machine.watch(8.98, lost) == []
    (entered,) = machine.watch(9.0, lost)
    assert isinstance(entered, ResponseNeeded) and entered.response == "vent"
    machine.watch(9.1, BENT)
    (entered,) = machine.watch(9.2, lost)
    assert isinstance(entered, ResponseNeeded) and entered.response == "vent", "nobody has asked for it again"
    machine.watch(9.3, BENT)
    machine.triggered()
    (entered,) = machine.watch(9.4, lost)
    assert isinstance(entered, ResponseNeeded) and entered.response == "hold"


def test_a_lost_autopilot_is_never_held() -> None:
    """Without the autopilot, altitude and arming are unknown."""
    machine = safety(losses=config.LossesConfig(on_rc_loss="hold"))
    (entered,) = machine.watch(0.0, but(BENT, autopilot_age_s=3.1))
    assert isinstance(entered, ResponseNeeded) and entered.response == "vent"


def test_faults_that_are_newer_than_the_state_that_was_seen_stay() -> None:
    machine = safety()
    machine.watch(1.0, but(FLYING, cv_kPa=25.5))
    machine.watch(1.1, FLYING)
    machine.watch(2.0, but(FLYING, physics={"venting": "not venting"}))
    machine.watch(2.1, FLYING)
    assert machine.clear(FLYING, seen_at=0.9) == {}
    assert list(machine.clear(FLYING, seen_at=1.9)) == ["overpressure"]
    assert list(machine.clear(FLYING, seen_at=2.0)) == ["venting"]


def test_a_fault_that_returns_counts_as_not_seen() -> None:
    machine = safety()
    for t in (1.0, 3.0):
        machine.watch(t, but(FLYING, cv_kPa=25.5))
        machine.watch(t + 0.1, FLYING)
    assert machine.clear(FLYING, seen_at=2.0) == {}
    assert list(machine.clear(FLYING, seen_at=3.0)) == ["overpressure"]


def test_faults_of_the_firmware_count_as_seen_only_after_the_last_new_one() -> None:
    machine = safety()
    machine.watch(1.0, but(FLYING, faults=Fault.DEAD_MAN))
    machine.watch(2.0, but(FLYING, faults=Fault.DEAD_MAN | Fault.SUPPLY))
    machine.watch(3.0, but(FLYING, faults=Fault.SUPPLY))
    assert not machine.firmware_faults_seen(1.9)
    assert machine.firmware_faults_seen(2.0)


@pytest.mark.parametrize(
    ("faults", "text"), [(Fault.DEAD_MAN, "dead-man timer ran out"), (Fault(0x4000), "0x4000")]
)
def test_a_fault_of_the_firmware_is_reported_by_its_name_or_number(faults: Fault, text: str) -> None:
    (entered,) = safety().watch(0.0, but(BENT, faults=faults))
    assert isinstance(entered, ResponseNeeded)
    assert entered.reason == f"firmware fault: {text}"


@pytest.mark.parametrize("altitude_m", [None, -3.0])
def test_no_altitude_ends_a_bend_that_needs_no_altitude(altitude_m: float | None) -> None:
    machine = safety(interlocks=config.InterlocksConfig(min_altitude_m=0.5))
    assert machine.watch(0.0, but(BENT, altitude_m=altitude_m)) == []


def test_an_absent_board_is_one_loss() -> None:
    (entered,) = safety().watch(0.0, but(BENT, firmware_ready=False, telemetry_age_s=1.0))
    assert isinstance(entered, ResponseNeeded)
    assert entered.name == "serial"


def test_a_board_that_ignores_a_setpoint_vents_and_one_that_does_not_vent_latches() -> None:
    for moving, name in ((True, "deaf"), (False, "regulates")):
        machine = safety()
        (entered,) = machine.watch(0.0, but(BENT, moving=moving, mode_mismatch_s=0.31))
        assert isinstance(entered, ResponseNeeded)
        assert entered.name == name
        machine.watch(1.0, FLYING)
        assert list(machine.reasons) == ([] if moving else ["regulates"])


@given(
    st.lists(
        st.tuples(st.sampled_from(["rc", "no rc", "trigger"]), st.floats(0.02, 8.0)), min_size=1, max_size=40
    )
)
def test_no_sequence_of_losses_prolongs_a_hold_or_a_bend(history: list[tuple[str, float]]) -> None:
    """A model of the core: a loss holds or vents the vine, and a trigger bends it if nothing is lost."""
    held_at_most_s, bent_at_most_s, tick_s = 3.0, 12.0, 0.02
    machine = safety(
        losses=config.LossesConfig(on_rc_loss="hold", hold_at_most_s=held_at_most_s),
        limits=config.LimitsConfig(max_bent_s=bent_at_most_s),
    )
    tick, lost, bent, held_s = 0, False, False, 0.0
    triggered_at = 0.0
    for what, lasts_s in history:
        lost = what == "no rc" or (lost and what == "trigger")
        if what == "trigger" and not lost:
            bent, held_s, triggered_at = True, 0.0, tick * tick_s
            machine.triggered()
        for _ in range(max(1, int(lasts_s / tick_s))):
            t = tick * tick_s
            now = but(
                BENT if bent else FLYING,
                rc_problem="silent" if lost else None,
                moving_s=t - triggered_at if bent else 0.0,
            )
            for change in machine.watch(t, now):
                bent = bent and not (isinstance(change, ResponseNeeded) and change.response == "vent")
            tick += 1
            if bent:
                held_s += tick_s if lost else 0.0
                assert held_s <= held_at_most_s + 0.1
                assert tick * tick_s - triggered_at <= bent_at_most_s + 0.1


CONDITIONS = st.builds(
    lambda **drawn: SafetyInputs(**drawn),  # with the class itself, Hypothesis also draws all other fields
    armed=st.booleans(),
    altitude_m=st.none() | st.floats(-5, 50),
    rc_problem=st.none() | st.just("silent"),
    autopilot_age_s=st.none() | st.floats(0, 10),
    firmware_ready=st.booleans(),
    firmware_was_ready=st.booleans(),
    telemetry_age_s=st.floats(0, 1) | st.just(math.inf),
    faults=st.sampled_from([Fault.NONE, Fault.CV_SENSOR, Fault.DEAD_MAN | Fault.CV_OVERPRESSURE]),
    cv_kPa=st.floats(-5, 40) | st.just(math.nan),
    reservoir_kPa=st.floats(-5, 800) | st.just(math.nan),
    moving=st.booleans(),
    moving_s=st.floats(0, 200),
    physics=st.sampled_from([{}, {}, {"filling": "not filling"}]),
)


@given(st.lists(CONDITIONS, min_size=1, max_size=30), st.data())
def test_a_bend_is_accepted_exactly_while_all_conditions_are_good(
    history: list[SafetyInputs], data: st.DataObject
) -> None:
    machine = safety()
    latched = False
    for i, now in enumerate(history):
        machine.watch(float(i), now)
        present = now.cv_kPa > 25.0 or bool(now.physics)
        latched = latched or present
        if data.draw(st.booleans()):
            machine.clear(now)
            latched = latched and present
        accepted = machine.judge(BEND, AIR, now).verdict != "refused"
        fit = (
            now.armed
            and now.altitude_m is not None
            and now.altitude_m >= 2.0
            and now.rc_problem is None
            and now.autopilot_age_s is not None
            and now.autopilot_age_s <= 3.0
            and now.firmware_ready
            and now.telemetry_age_s <= 0.3
            and not now.faults
            and not latched
            and now.reservoir_kPa >= 65.0
        )
        assert accepted == fit
        assert machine.judge(RELEASE, AIR, now).verdict == "accepted"
