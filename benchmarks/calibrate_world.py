"""A compiled simulation of a rig for a calibration, about 100 times as fast as real time.

Each request is accepted and goes to the firmware's regulator, as from the core. Safety and serial line are
not simulated; tests of the service cover them.
"""

from __future__ import annotations

import math

from cycles_left_flights import telemetry_messages

from flying_vines.calibration.calibrator import (
    BY,
    LATE_S,
    Calibrator,
    EvaluationTask,
    OperatorRequest,
    Output,
    Question,
)
from flying_vines.calibration.evaluation import StageRecording
from flying_vines.calibration.plan import CalibrationPlan
from flying_vines.core.core import TICK_S
from flying_vines.core.events import Decision, Measured
from flying_vines.core.motion_planner import MotionPlanner
from flying_vines.core.snapshot import Snapshot
from flying_vines.physics.plant.plant import State, at_rest
from flying_vines.physics.plant.setup import Setup
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop
from flying_vines.vine.intent import Intent, SetPressure, StartProfile
from flying_vines.vine.motion import Motion

LOOKS_S = 0.1
"""Time between ticks of the calibrator."""


class CompiledWorld:
    """One rig, filled to a true gauge pressure, with telemetry every `step_ms`."""

    def __init__(
        self, plan: CalibrationPlan, rig: Setup, fill_kPa: float, seed: int, step_ms: int = 1
    ) -> None:
        self.calibrator = Calibrator(plan)
        self.now = 0.0
        self.asked: list[Intent] = []
        self.recording: StageRecording | None = None
        """Data of the last evaluated stage."""
        self._rig = rig
        self._seed = seed
        self._step_ms = step_ms
        self._planner = MotionPlanner(plan.config)
        self._state: State = at_rest(rig.plant, fill_kPa)
        self._reservoir_true_kPa = fill_kPa
        self._motion: Motion | None = None
        self._cv_kPa = math.nan
        self._reservoir_kPa = math.nan

    @property
    def reservoir_kPa(self) -> float:
        """True pressure."""
        return self._reservoir_true_kPa

    def run(self) -> Calibrator:
        """Run the calibration to its end."""
        self._carry_out(self.calibrator.begin(self.now))
        while self.calibrator.ended is None:
            motion = self._motion
            left_s = motion.duration_s - (self.now - motion.started_at) if motion else 0.0
            self._live(max(1.0, left_s + LATE_S + 2.0 * LOOKS_S))
        return self.calibrator

    def _live(self, seconds: float) -> None:
        """Simulate the present motion for this time."""
        begun_s, motion = self.now, self._motion
        ticks = round(seconds / TICK_S)
        setpoints = [SetpointChange(0.0, math.nan, 1.0)]
        if motion is not None:
            setpoints = [
                SetpointChange(
                    i * TICK_S, motion.setpoint_kPa(begun_s + (i + 1) * TICK_S), motion.rate_kPa_per_s
                )
                for i in range(ticks)
            ]
        self._seed += 1
        run = closed_loop(
            self._rig.plant, setpoints, seconds, self._state,
            cv_sensor=self._rig.cv_sensor, reservoir_sensor=self._rig.reservoir_sensor,
            seed=self._seed, record_every=self._step_ms,
        )  # fmt: skip
        self._state = run.state
        self._reservoir_true_kPa = float(run.table["reservoir_kPa"][-1])
        looks = begun_s
        run.table["time_s"] += begun_s
        for self.now, telemetry in telemetry_messages(run.table):
            self._cv_kPa, self._reservoir_kPa = telemetry.cv_kPa, telemetry.reservoir_kPa
            self._carry_out(self.calibrator.take(Measured(self.now, telemetry)))
            if self.now >= looks:
                looks += LOOKS_S
                self._carry_out(self.calibrator.tick(self.now, self._snapshot()))
        self.now = begun_s + seconds

    def _carry_out(self, outs: list[Output]) -> None:
        for out in outs:
            match out:
                case OperatorRequest(intent):
                    self._ask(intent)
                case Question():
                    self._carry_out(self.calibrator.answer(self.now, out, ""))
                case EvaluationTask():
                    self.recording = out.run.__self__  # type: ignore[attr-defined]
                    self._carry_out(self.calibrator.evaluated(self.now, out, out.run()))

    def _ask(self, intent: Intent) -> None:
        self.asked.append(intent)
        if isinstance(intent, StartProfile | SetPressure):
            start_kPa = self._motion.setpoint_kPa(self.now) if self._motion else 0.0
            self._motion = self._planner.plan(intent, start_kPa, 0.0, started_at=self.now)
        else:
            self._motion = None
        decision = Decision(self.now, BY, {}, str(intent), "accepted", "", 0.0)
        self._carry_out(self.calibrator.take(decision))

    def _snapshot(self) -> Snapshot:
        return Snapshot(
            t=self.now, vehicle="not found", mode="", armed=False, altitude_m=math.nan, rc="none",
            switch_position=None, actuator="phloSAR", firmware="ready", round_trip_s=None,
            telemetry_gaps=0, reservoir_kPa=self._reservoir_kPa, cv_kPa=self._cv_kPa, command_kPa=0.0,
            bend_deg=0.0, evp_opening=0.0, dvp_opening=0.0, solenoid=None, cycles=None,
            doing="vented" if self._motion is None else self._motion.name, bench=True,
        )  # fmt: skip
