"""A core with a simulated phloSAR for a calibrator, and a world without physics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.calibration.calibrator import (
    BY,
    Calibrator,
    Ended,
    EvaluationTask,
    Message,
    OperatorRequest,
    Output,
    Question,
)
from flying_vines.calibration.findings import Findings
from flying_vines.calibration.plan import CalibrationPlan
from flying_vines.calibration.rig import result_of
from flying_vines.core.events import Action, Asked, Decision, Measured
from flying_vines.core.snapshot import Snapshot
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedWorld
from flying_vines.vine.intent import Intent, SetPressure, StartProfile, VentVine

STEP_S = 0.05
Person = Callable[[Question], str | None]


def presses_enter(_: Question) -> str:
    return ""


class _Stage:
    """Carries out and stores the outputs of a calibrator."""

    def __init__(self, plan: CalibrationPlan, person: Person = presses_enter) -> None:
        self.calibrator = Calibrator(plan)
        self.person = person
        self.outputs: list[Output] = []
        self.now = 0.0

    @property
    def asked(self) -> list[Intent]:
        return [out.intent for out in self.outputs if isinstance(out, OperatorRequest)]

    @property
    def ended(self) -> Ended | None:
        return self.calibrator.ended

    def carry_out(self, outs: Iterable[Output]) -> None:
        for out in outs:
            self.outputs.append(out)
            if isinstance(out, OperatorRequest):
                self.ask(out.intent)
            elif isinstance(out, Question):
                self.carry_out(self.calibrator.answer(self.now, out, self.person(out)))
            elif isinstance(out, EvaluationTask):
                self.carry_out(self.calibrator.evaluated(self.now, out, self.evaluate(out)))

    def ask(self, intent: Intent) -> None:
        raise NotImplementedError

    def evaluate(self, task: EvaluationTask) -> object:
        return result_of(task)

    def sentences(self) -> list[str]:
        return [out.text for out in self.outputs if isinstance(out, Message)]


class CoreWorld(_Stage):
    """The complete core, with safety and checks, and a simulated phloSAR."""

    def __init__(
        self, plan: CalibrationPlan, phlosar: SimulatedPhlosar, person: Person = presses_enter
    ) -> None:
        super().__init__(plan, person)
        self.phlosar = phlosar
        self.world = SimulatedWorld(plan.config, phlosar)
        self._actions: list[Action] = []

    def run(self, most_s: float, until: Callable[[], bool] = lambda: False) -> None:
        """Run until the calibration has ended, or until `until` is true."""
        if not self.outputs:
            self.carry_out(self.calibrator.begin(self.now))
        while self.ended is None and self.now < most_s and not until():
            self.now += STEP_S
            self._receive(self.world.advance(self.now))
            self.carry_out(self.calibrator.tick(self.now, self.world.core.snapshot(self.now)))

    def run_core(self, seconds: float = 3.0) -> None:
        """Run the core without the calibrator, long enough to carry out the latest request."""
        self.now += seconds
        list(self.world.advance(self.now))

    def ask(self, intent: Intent) -> None:
        self._receive(self.world.feed(Asked(self.now, BY, intent)))

    def _receive(self, actions: Iterable[Action]) -> None:
        for action in actions:
            self.carry_out(self.calibrator.take(action))

    @property
    def vented(self) -> bool:
        return self.phlosar.cv_kPa < 1.0 and self.phlosar.drive.evp == 0.0


class PaperWorld(_Stage):
    """No physics: the vine follows its setpoint, and the reservoir stays full."""

    def __init__(
        self, plan: CalibrationPlan, person: Person = presses_enter, reservoir_kPa: float = 690.0
    ) -> None:
        super().__init__(plan, person)
        self.bent = False
        self.snapshot = Snapshot(
            t=0.0, vehicle="not found", mode="", armed=False, altitude_m=math.nan, rc="none",
            switch_position=None, actuator="phloSAR", firmware="ready", round_trip_s=None,
            telemetry_gaps=0, reservoir_kPa=reservoir_kPa, cv_kPa=0.0, command_kPa=0.0, bend_deg=0.0,
            evp_opening=0.0, dvp_opening=0.0, solenoid=True, cycles=None, doing="vented",
        )  # fmt: skip
        self.refuses: dict[type[Intent], str] = {}

    def run(self, most_s: float = 1e5) -> None:
        if not self.outputs:
            self.carry_out(self.calibrator.begin(self.now))
        while self.ended is None and self.now < most_s:
            self.now += 0.5
            self.snapshot = replace(self.snapshot, t=self.now, cv_kPa=20.0 if self.bent else 0.0)
            self.carry_out(self.calibrator.take(Measured(self.now, self._telemetry())))
            self.carry_out(self.calibrator.tick(self.now, self.snapshot))

    def ask(self, intent: Intent) -> None:
        why = self.refuses.get(type(intent), "")
        if isinstance(intent, StartProfile | SetPressure) and not why:
            self.bent = True
        elif isinstance(intent, VentVine):
            self.bent = False
        ruling = Decision(self.now, BY, {}, str(intent), "refused" if why else "accepted", why, 0.0)
        self.carry_out(self.calibrator.take(ruling))

    def evaluate(self, task: EvaluationTask) -> object:
        return Findings()

    def _telemetry(self) -> Telemetry:
        mode = Mode.REGULATE if self.bent else Mode.VENT
        kPa = self.snapshot.cv_kPa
        return Telemetry(
            round(1000 * self.now),
            mode,
            Fault.NONE,
            0,
            kPa,
            kPa,
            self.snapshot.reservoir_kPa,
            0.0,
            0.0,
            not self.bent,
        )
