"""A calibration of a simulated rig in simulated time; recorded as a flight."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

from flying_vines.calibration.calibrator import Calibrator, EvaluationTask, Question
from flying_vines.calibration.driver import (
    INTERRUPTED,
    LAST_VENT_S,
    STEP_S,
    CalibrateError,
    CalibrationContext,
    CalibrationDriver,
    CalibrationOutcome,
    CalibrationRun,
    UserConfiguration,
    flight_start,
    load_context,
    planned,
    result_of,
)
from flying_vines.calibration.plan import CalibrationPlan, CalibrationRequest
from flying_vines.calibration.real_rig import EVERY_STEP_HZ
from flying_vines.calibration.terminal import CalibrationTerminal
from flying_vines.config.config import Config
from flying_vines.core.events import Action, Asked, Event, Stop, ToVehicle
from flying_vines.core.snapshot import Snapshot
from flying_vines.physics.plant.true_rig import load_true_rig
from flying_vines.record.recorder import Recorder
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedWorld
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vine.curve import BendCurve
from flying_vines.vine.intent import Intent

STEPS_PER_SNAPSHOT = 5
CURVE = ((0.0, 0.0), (3.0, 0.0), (6.0, 17.0), (9.0, 30.0), (12.0, 40.0), (16.0, 50.0), (21.0, 58.0))
"""Bend curve of the simulated vine; it differs from the configured one."""
HYSTERESIS_KPA = 1.2
READING_SD_DEG = 1.0


def calibrate(
    user: UserConfiguration,
    request: CalibrationRequest,
    out: Path,
    terminal: CalibrationTerminal,
    rig: Path | None,
) -> CalibrationRun:
    """Calibrate the rig of a rig file; without a file, a rig with all typical effects.

    Raises `CalibrateError`, the errors of `load_context`, or `OSError`.
    """
    if request.vessel_L is not None:
        raise CalibrateError("--vessel-L needs a person who changes a hose; it does not work with --fake")
    config, context = load_context(user)
    plan = planned(config, request)
    phlosar = SimulatedPhlosar(
        load_true_rig(rig) if rig else None,
        {"telemetry_Hz": EVERY_STEP_HZ},
        reservoir_kPa=0.0 if request.bottle_empty else config.pneumatics.full_kPa,
    )
    terminal.introduce(plan)
    with _interruptions() as interrupted, terminal.live():
        outcome = _run(plan, context, phlosar, out, terminal, interrupted)
        return CalibrationRun(outcome, config.pneumatics, interrupted(), {}, False)


@contextmanager
def _interruptions() -> Iterator[Callable[[], bool]]:
    """In this context Ctrl-C only makes the yielded function return True, so that a vent can follow."""
    seen: list[int] = []
    before = {
        name: signal.signal(name, lambda number, frame: seen.append(number))
        for name in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield lambda: bool(seen)
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)


def _run(
    plan: CalibrationPlan,
    context: CalibrationContext,
    phlosar: SimulatedPhlosar,
    parent: Path,
    terminal: CalibrationTerminal,
    stopped: Callable[[], bool],
) -> CalibrationOutcome:
    """The calibration ends once `stopped` returns True.

    The flight's folder is made in `parent`. Raises `OSError` if that fails.
    """
    recorder = Recorder(parent, flight_start(plan, context), plan.config.log.least_free_MB, t=0.0)
    calibrator = Calibrator(plan)
    world = _RecordedWorld(plan.config, phlosar, context, recorder)
    angles = SimulatedAngleReader(seed=1)

    def ask(intent: Intent) -> None:
        driver.actions.extend(world.feed(Asked(world.now, "calibration", intent)))

    def question(asked: Question) -> None:
        answer = ""
        if asked.kind == "angle":
            answer = f"{angles.read(phlosar.cv_kPa):.1f}"
        elif asked.number > 1:
            # The first question asks to empty the reservoir, which is empty. The second asks to fill it.
            phlosar.fill(plan.user_config.pneumatics.full_kPa)
        driver.carry_out(calibrator.answer(world.now, asked, answer))

    def evaluate(task: EvaluationTask) -> None:
        driver.carry_out(calibrator.evaluated(world.now, task, result_of(task)))

    driver = CalibrationDriver(calibrator, terminal, ask, question, evaluate)

    def step(number: int) -> Snapshot:
        driver.actions.extend(world.advance(number * STEP_S))
        snapshot = world.core.snapshot(world.now)
        if number % STEPS_PER_SNAPSHOT == 0:
            recorder.snapshot(snapshot)
        return snapshot

    number = 1
    try:
        step(number)
        driver.carry_out(calibrator.begin(world.now))
        while calibrator.ended is None:
            number += 1
            snapshot = step(number)
            if stopped():
                driver.carry_out(calibrator.stop(world.now, INTERRUPTED))
            driver.step(world.now, snapshot)
        last = number + round(LAST_VENT_S / STEP_S)
        while number < last and not driver.vented(step(number)):
            number += 1
        driver.actions.extend(world.feed(Stop(world.now)))
    finally:
        recorder.close()
    return driver.outcome(recorder.folder, recorder.news)


class _RecordedWorld(SimulatedWorld):
    """A simulated world that records the same events and actions as the service does."""

    def __init__(
        self, config: Config, phlosar: SimulatedPhlosar, context: CalibrationContext, recorder: Recorder
    ) -> None:
        super().__init__(config, phlosar, prior=context.prior, stored=context.stored)
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


class SimulatedAngleReader:
    """A person who reads the angle of the simulated vine, with hysteresis and reading errors."""

    def __init__(self, seed: int = 1) -> None:
        self._curve = BendCurve(CURVE, HYSTERESIS_KPA)
        self._random = Random(seed)
        self._bent_kPa = 0.0

    def read(self, cv_kPa: float) -> float:
        """The angle in degrees at a true gauge pressure. Call it in the order of the movement."""
        self._bent_kPa = self._curve.bent_kPa(cv_kPa, self._bent_kPa)
        angle_deg = self._curve.angle_deg(self._bent_kPa) + self._random.gauss(0.0, READING_SD_DEG)
        return round(max(0.0, angle_deg), 1)
