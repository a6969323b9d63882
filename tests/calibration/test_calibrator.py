"""The state machine: its requests, its end, and that it always vents the vine."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from calibration_worlds import CoreWorld, PaperWorld
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import examples
from flying_vines.calibration.calibrator import Calibrator, EvaluationTask, Question, StageBegan, StageResult
from flying_vines.calibration.findings import Findings, MeasuredQuantity
from flying_vines.calibration.plan import STAGES, CalibrationRequest, plan
from flying_vines.config import config
from flying_vines.core.events import Decision
from flying_vines.physics.plant.effects import Effects
from flying_vines.simulation.phlosar.mishaps import Hole, HoseOff, MishapKind, Shorted
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.vine.intent import SetPressure, StartBench, StartProfile, VentVine

CONFIG = config.default()
BLIND = CalibrationRequest(asks_angles=False)


def phlosar(**given: object) -> SimulatedPhlosar:
    return SimulatedPhlosar(effects=Effects(), **given)  # type: ignore[arg-type]


def stages_of(world: PaperWorld | CoreWorld) -> list[str]:
    return [out.stage.name for out in world.outputs if isinstance(out, StageBegan)]


def test_goes_through_all_stages_in_order_and_ends_vented() -> None:
    world = PaperWorld(plan(CONFIG, CalibrationRequest(reservoir_empty=True, vessel_L=0.5)))
    world.run()
    assert world.ended is not None and world.ended.outcome == "done"
    assert stages_of(world) == list(STAGES)
    assert world.asked[-1] == VentVine() and not world.bent
    assert world.calibrator.progress.share == 1.0


def test_every_movement_is_followed_by_a_vent_before_anything_is_evaluated() -> None:
    world = PaperWorld(plan(CONFIG, BLIND))
    world.run()
    bent = False
    for out in world.outputs:
        if isinstance(out, EvaluationTask | Question):
            assert not bent
        intent = getattr(out, "intent", None)
        bent = isinstance(intent, StartProfile) if intent else bent


def test_only_the_requested_stages_and_the_zero() -> None:
    world = PaperWorld(plan(CONFIG, replace(BLIND, only=("vine_leak",))))
    world.run()
    assert stages_of(world) == ["zero", "vine_leak"]


def test_repeats_an_imprecise_movement_but_not_forever() -> None:
    world = PaperWorld(plan(CONFIG, replace(BLIND, only=("levels",))))
    world.run()
    stage = world.calibrator.plan.stages[-1]
    moves = [intent for intent in world.asked if isinstance(intent, StartProfile)]
    assert len(moves) == len(stage.movements) + stage.max_repeats * len(stage.again)


@settings(max_examples=examples(40), deadline=None)
@given(
    after=st.integers(0, 700),
    how=st.sampled_from(["ctrl-c", "serial", "fault", "failsafe", "page", "refused"]),
)
def test_the_last_request_is_always_to_vent(after: int, how: str) -> None:
    world = PaperWorld(plan(CONFIG, CalibrationRequest()), person=lambda question: "10")
    world.run(after / 2.0)
    calibrator = world.calibrator
    if how == "ctrl-c":
        world.carry_out(calibrator.stop(world.now, "interrupted"))
    elif how == "serial":
        world.snapshot = replace(world.snapshot, firmware="disconnected")
    elif how == "fault":
        world.snapshot = replace(world.snapshot, safe_state={"overpressure": "vine at 40.0 kPa, limit 25"})
    elif how == "failsafe":
        world.carry_out(
            calibrator.take(Decision(world.now, "failsafe", {}, "vent", "accepted", "reservoir low", 0.0))
        )
    elif how == "page":
        world.carry_out(calibrator.take(Decision(world.now, "page", {}, "vent", "accepted", "", 0.0)))
    else:
        world.refuses = {StartProfile: "no", SetPressure: "no", StartBench: "no"}
    world.run()
    assert world.ended is not None
    assert world.ended.outcome in ("done", "stopped", "refused") and world.ended.sentence
    assert world.asked[-1] == VentVine() and not world.bent
    # Nothing follows.
    assert calibrator.tick(world.now + 1.0, world.snapshot) == calibrator.stop(world.now, "again") == []


@pytest.mark.parametrize(("zero_kPa", "reads_kPa", "vented"), [(3.0, 3.5, True), (-3.0, 0.0, False)])
def test_the_last_vent_ends_when_the_vine_is_vented_by_its_measured_zero(
    zero_kPa: float, reads_kPa: float, vented: bool
) -> None:
    world = PaperWorld(plan(CONFIG, BLIND))
    found = MeasuredQuantity("cv_zero_kPa", "zero", "kPa", zero_kPa, zero_kPa, zero_kPa)
    world.calibrator.findings = Findings((found,))
    calibrator = world.calibrator
    assert calibrator.vented(replace(world.snapshot, cv_kPa=reads_kPa)) == vented
    assert calibrator.vented(replace(world.snapshot, cv_kPa=math.nan))
    assert not calibrator.vented(replace(world.snapshot, doing="regulating"))


def test_too_little_air_is_refused_before_anything_moves() -> None:
    world = PaperWorld(plan(CONFIG, BLIND), reservoir_kPa=70.0)
    world.run()
    assert world.ended is not None and world.ended.outcome == "refused"
    assert "the reservoir holds 70 kPa, but " in world.ended.sentence
    assert not any(isinstance(intent, StartProfile) for intent in world.asked)


def test_a_board_that_never_answers_ends_it() -> None:
    world = PaperWorld(plan(CONFIG, BLIND))
    world.snapshot = replace(world.snapshot, firmware="does not answer")
    world.run(60.0)
    assert world.ended is not None and world.ended.sentence == "phloSAR does not answer"
    assert world.now < 20.0


@pytest.mark.parametrize(
    ("safe_state", "because"),
    [({}, ""), ({"telemetry": "phloSAR telemetry stale"}, " (phloSAR telemetry stale)")],
)
def test_a_board_that_answers_without_a_pressure_ends_it_with_what_to_do(
    safe_state: dict[str, str], because: str
) -> None:
    world = PaperWorld(plan(CONFIG, BLIND))
    calibrator = world.calibrator
    world.carry_out(calibrator.begin(0.0))
    mute = replace(world.snapshot, cv_kPa=math.nan, safe_state=safe_state)
    while calibrator.ended is None and world.now < 60.0:
        world.now += 0.5
        world.carry_out(calibrator.tick(world.now, mute))
    assert calibrator.ended is not None and calibrator.ended.sentence == (
        f"phloSAR answers, but sends no pressure of the vine{because}: try another cable, or flash its "
        "firmware again"
    )
    assert calibrator.ended.outcome == "refused" and 15.0 < world.now < 20.0


def test_an_armed_vehicle_is_not_calibrated() -> None:
    world = PaperWorld(plan(CONFIG, BLIND))
    world.snapshot = replace(world.snapshot, armed=True)
    world.run(60.0)
    assert world.ended is not None and "armed" in world.ended.sentence


def test_nobody_to_swap_the_hose_ends_it() -> None:
    world = PaperWorld(plan(CONFIG, replace(BLIND, vessel_L=0.5)), person=lambda question: None)
    world.run()
    assert world.ended is not None and world.ended.sentence == "Reservoir's volume: nobody answered"


def test_without_an_answer_for_the_angle_the_vine_is_vented() -> None:
    world = PaperWorld(plan(CONFIG, CalibrationRequest(only=("angle",))), person=lambda question: None)
    world.run()
    assert world.ended is not None and world.ended.outcome == "done"
    assert world.calibrator.findings.pairs == ()
    assert not world.bent


def test_a_person_who_never_answers_does_not_keep_the_vine_bent() -> None:
    class Silent(PaperWorld):
        def carry_out(self, outs):  # type: ignore[no-untyped-def]
            super().carry_out(out for out in outs if not isinstance(out, Question))

    world = Silent(plan(CONFIG, CalibrationRequest(only=("angle",))))
    world.run()
    assert world.ended is not None and not world.bent
    assert world.now < 120.0


def test_angles_are_collected_and_a_bad_answer_is_asked_again() -> None:
    answers = iter(["0", "abc", "10°", "", "12,5"])
    world = PaperWorld(
        plan(CONFIG, CalibrationRequest(only=("angle",))), person=lambda question: next(answers, None)
    )
    world.run()
    assert [deg for _, deg in world.calibrator.findings.pairs] == [0.0, 10.0, 12.5]
    assert "'abc' is not an angle in degrees" in world.sentences()


def test_a_failed_evaluation_ends_only_its_stage() -> None:
    class Broken(PaperWorld):
        def evaluate(self, task: EvaluationTask) -> object:
            return ZeroDivisionError("nothing there")

    world = Broken(plan(CONFIG, replace(BLIND, only=("reservoir_leak",))))
    world.run()
    assert world.ended is not None and world.ended.outcome == "done"
    assert any("could not be evaluated: nothing there" in text for text in world.sentences())


def test_unexpected_answers_and_results_change_nothing() -> None:
    calibrator = Calibrator(plan(CONFIG, BLIND))
    calibrator.begin(0.0)
    assert calibrator.answer(1.0, Question(7, "enter", "?"), "") == []
    assert calibrator.evaluated(1.0, EvaluationTask(calibrator.plan.stages[0], lambda: None), None) == []  # type: ignore[arg-type,return-value]


# With the complete core.


@pytest.fixture(scope="module")
def measured() -> CoreWorld:
    world = CoreWorld(plan(CONFIG, replace(BLIND, only=("levels",))), phlosar())
    world.run(400.0, until=lambda: sum(isinstance(out, StageResult) for out in world.outputs) >= 2)
    return world


def test_the_core_carries_out_its_requests(measured: CoreWorld) -> None:
    volume = measured.calibrator.findings.get("cv_volume_L")
    assert volume is not None and volume.value is not None and volume.low is not None
    assert volume.value == pytest.approx(0.1, rel=0.35)
    assert {chart.name for chart in measured.calibrator.findings.charts} >= {"zero", "reservoir", "levels"}


def test_interrupted_while_the_vine_is_bent_it_is_vented() -> None:
    world = CoreWorld(plan(CONFIG, replace(BLIND, only=("vine_leak",))), phlosar())
    world.run(60.0, until=lambda: world.phlosar.cv_kPa > 20.0)
    assert world.phlosar.cv_kPa > 20.0
    world.carry_out(world.calibrator.stop(world.now, "interrupted"))
    world.run_core()
    assert world.vented
    assert world.ended is not None and world.ended.outcome == "stopped"
    assert world.ended.sentence == "Vine's leak: interrupted"


@pytest.mark.parametrize(
    ("stage", "place", "kind", "begins_s", "says"),
    [
        ("zero", "cv_sensor", Shorted(), 4.0, "pressure sensor"),
        ("reservoir_leak", "reservoir", Hole(4.0), 15.0, "reservoir loses"),
        ("levels", "cv_sensor", Shorted(), 12.0, "pressure sensor"),
        ("levels", "hose", HoseOff(), 5.0, "not filling"),
        ("vine_leak", "actuator", Hole(4.0), 15.0, "not filling"),
        ("valve", "reservoir_sensor", Shorted(), 13.0, "reservoir pressure sensor"),
    ],
)
def test_a_fault_ends_it_vented_with_its_sentence(
    stage: str, place: str, kind: MishapKind, begins_s: float, says: str
) -> None:
    rig = phlosar()
    world = CoreWorld(plan(CONFIG, replace(BLIND, only=(stage,))), rig)
    world.run(begins_s)
    rig.inject(place, kind)
    world.run(60.0)
    assert world.ended is not None and world.ended.outcome in ("stopped", "refused")
    assert says in world.ended.sentence
    assert world.asked[-1] == VentVine()
    world.run_core()
    assert world.phlosar.drive.evp == 0.0 and world.phlosar.drive.solenoid


def test_with_a_large_zero_nothing_is_moved() -> None:
    rig = phlosar(firmware={"cv_zero_kPa": 6.0})
    world = CoreWorld(plan(CONFIG, replace(BLIND, only=("levels",))), rig)
    world.run(60.0)
    assert world.ended is not None and world.ended.outcome == "refused"
    assert "set cv_zero_kPa" in world.ended.sentence
    (proposal,) = world.calibrator.findings.proposals
    assert proposal.setting == "cv_zero_kPa" and proposal.value == pytest.approx(-6.0, abs=0.1)
