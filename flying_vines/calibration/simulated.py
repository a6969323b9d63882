"""A calibration in simulated time: the core, a simulated phloSAR and person; recorded as a flight."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from flying_vines.calibration.calibrator import Calibrator, Question, Work
from flying_vines.calibration.conductor import (
    INTERRUPTED,
    STEP_S,
    VENTS_WITHIN_S,
    Beholder,
    Conducted,
    Conductor,
    began,
    done,
    vented,
)
from flying_vines.calibration.eye import SimulatedEye
from flying_vines.calibration.known import KnownBeforehand
from flying_vines.calibration.plan import CalibrationPlan
from flying_vines.config.config import Config
from flying_vines.core.events import Action, Asked, Event, Snapshot, Stop, ToVehicle
from flying_vines.record.recorder import Recorder
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedWorld
from flying_vines.supply import Belief
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vine.intent import Intent

STEPS_A_SNAPSHOT = 5


def calibrate(
    plan: CalibrationPlan,
    known: KnownBeforehand,
    phlosar: SimulatedPhlosar,
    parent: Path,
    beholder: Beholder,
    stopped: Callable[[], bool],
) -> Conducted:
    """Calibrate a simulated rig, as fast as the machine goes; it ends once `stopped` says so.

    The flight's folder is made in `parent`; `OSError` where that cannot be.
    """
    recorder = Recorder(parent, began(plan, known), plan.config.log.least_free_MB, t=0.0)
    calibrator = Calibrator(plan)
    world = _RecordedWorld(plan.config, phlosar, known.belief, recorder)
    eye = SimulatedEye(seed=1)

    def ask(intent: Intent) -> None:
        conductor.actions.extend(world.feed(Asked(world.now, "calibration", intent)))

    def question(asked: Question) -> None:
        answer = ""
        if asked.kind == "angle":
            answer = f"{eye.sees(phlosar.cv_kPa):.1f}"
        elif asked.number > 1:
            # What is asked for first is that the bottle is empty, as it is.
            phlosar.fill(plan.believed.pneumatics.full_kPa)
        conductor.carry_out(calibrator.answer(world.now, asked, answer))

    def work(asked: Work) -> None:
        conductor.carry_out(calibrator.worked(world.now, asked, done(asked)))

    conductor = Conductor(calibrator, beholder, ask, question, work)

    def step(number: int) -> Snapshot:
        conductor.actions.extend(world.advance(number * STEP_S))
        snapshot = world.core.snapshot(world.now)
        if number % STEPS_A_SNAPSHOT == 0:
            recorder.snapshot(snapshot)
        return snapshot

    number = 1
    try:
        step(number)
        conductor.carry_out(calibrator.begin(world.now))
        while calibrator.ended is None:
            number += 1
            snapshot = step(number)
            if stopped():
                conductor.carry_out(calibrator.stop(world.now, INTERRUPTED))
            conductor.live(world.now, snapshot)
        last = number + round(VENTS_WITHIN_S / STEP_S)
        while number < last and not vented(step(number)):
            number += 1
        conductor.actions.extend(world.feed(Stop(world.now)))
    finally:
        recorder.close()
    return conductor.result(recorder.folder, recorder.failed)


class _RecordedWorld(SimulatedWorld):
    """One whose recorder sees what the service's sees."""

    def __init__(
        self, config: Config, phlosar: SimulatedPhlosar, belief: Belief | None, recorder: Recorder
    ) -> None:
        super().__init__(config, phlosar, belief=belief)
        self._recorder = recorder
        self._mavlink = MavlinkCodec(config.vehicle.system_id, config.vehicle.component_id)

    def feed(self, event: Event) -> Iterator[Action]:
        actions = list(super().feed(event))
        self._recorder.event(event)
        for action in actions:
            if isinstance(action, ToVehicle):
                self._mavlink.encode(action.message, action.system_id)
            self._recorder.action(action)
        return iter(actions)
