"""Carries out the outputs of a calibrator. `real_rig` and `simulated_rig` connect it to a rig."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import msgspec

from flying_vines.calibration.calibrator import (
    VENTED_KPA,
    Calibrator,
    Ended,
    EvaluationTask,
    OperatorRequest,
    Output,
    Question,
)
from flying_vines.calibration.findings import Chart, Findings
from flying_vines.calibration.plan import CalibrationPlan, CalibrationRequest, plan
from flying_vines.calibration.terminal import CalibrationTerminal
from flying_vines.config.config import Config, PneumaticsConfig
from flying_vines.config.config_text import configuration_text
from flying_vines.core.events import Action, StoredState
from flying_vines.core.snapshot import Snapshot
from flying_vines.record import recorder
from flying_vines.service.persistent_state import PersistentState
from flying_vines.service.starting import read_inputs
from flying_vines.supply import RigPrior
from flying_vines.vehicle.component.parameters import Parameters
from flying_vines.vehicle.mavlink.signing import Signing
from flying_vines.vine.intent import Intent

STEP_S = 0.02
LAST_VENT_S = 5.0
"""Maximum time to wait for the vent that ends a calibration, also an interrupted one."""
INTERRUPTED = "interrupted"


class CalibrateError(Exception):
    """The request cannot be met; the text is one sentence."""


@dataclass(frozen=True)
class UserConfiguration:
    """The configuration of the rig."""

    text: str
    path: Path | None
    """None: the built-in configuration."""
    config: Config

    @property
    def name(self) -> str:
        return str(self.path or "the built-in configuration")


@dataclass(frozen=True)
class CalibrationContext:
    """The rig file of the configuration, and the state that `run` has stored for it."""

    prior: RigPrior | None = None
    rig_text: str = ""
    """Content of the rig file."""
    stored: StoredState = field(default_factory=StoredState)
    """Contains only whether the pneumatics are disarmed. The parameters are already in the configuration."""
    signing: Signing | None = None
    state: PersistentState | None = None


def load_context(user: UserConfiguration) -> tuple[Config, CalibrationContext]:
    """The configuration as `run` would use it: with the stored parameters and the rig file.

    Raises `ConfigError`.
    """
    if user.path is None:
        return user.config, CalibrationContext()
    read = read_inputs(user.path)
    flown, prior = Parameters(read.config, read.stored.parameters).config, None
    if read.known:
        prior = read.known.prior
        flown = msgspec.structs.replace(flown, pneumatics=prior.pneumatics)
    stored = StoredState(disarmed=read.stored.disarmed)
    return flown, CalibrationContext(prior, read.rig_text, stored, read.signing, read.state)


def planned(config: Config, request: CalibrationRequest) -> CalibrationPlan:
    """Raises `CalibrateError` if the request cannot be met."""
    try:
        return plan(config, request)
    except ValueError as error:
        raise CalibrateError(str(error)) from None


class CalibrationOutcome(NamedTuple):
    folder: Path
    """Folder of the flight."""
    ended: Ended
    findings: Findings
    charts: tuple[Chart, ...]
    log_problem: str
    """One sentence if the log is incomplete: it ended, or it continues in another folder."""


@dataclass(frozen=True)
class CalibrationRun:
    """The outcome, and the proposed settings of the firmware."""

    outcome: CalibrationOutcome
    pneumatics: PneumaticsConfig
    """The rig file's numbers if the configuration names a rig file."""
    interrupted: bool
    firmware: Mapping[str, float]
    """Proposed settings."""
    is_set: bool
    """True if the proposed settings are saved in the firmware."""

    @property
    def done(self) -> bool:
        return self.outcome.ended.outcome == "done"


@dataclass
class CalibrationDriver:
    """Passes actions of the core to a calibrator, and carries out its outputs.

    `actions`: the core's actions that the calibrator has not taken yet, in order.
    """

    calibrator: Calibrator
    terminal: CalibrationTerminal
    ask: Callable[[Intent], None]
    question: Callable[[Question], None]
    evaluate: Callable[[EvaluationTask], None]
    actions: deque[Action] = field(default_factory=deque)
    _outputs: deque[Output] = field(default_factory=deque)
    """The first is being carried out."""

    def step(self, t: float, snapshot: Snapshot) -> None:
        """Take all actions until `t`, and let time pass."""
        self._take_actions()
        self.carry_out(self.calibrator.tick(t, snapshot))
        self._take_actions()
        self.terminal.progress(self.calibrator.progress)

    def carry_out(self, outputs: Sequence[Output]) -> None:
        """Carry out outputs in order. Outputs that they cause come after them."""
        self._outputs.extend(outputs)
        if len(self._outputs) > len(outputs):
            return
        while self._outputs:
            match self._outputs[0]:
                case OperatorRequest(intent):
                    self.ask(intent)
                case Question() as question:
                    self.question(question)
                case EvaluationTask() as task:
                    self.evaluate(task)
                case shown:
                    self.terminal.show(shown)
            self._outputs.popleft()

    def vented(self, snapshot: Snapshot) -> bool:
        """True if the core has vented the vine, and its pressure is low or unknown."""
        return snapshot.doing == "vented" and not self.calibrator.cv_kPa(snapshot) >= VENTED_KPA

    def outcome(self, folder: Path, log_problem: str) -> CalibrationOutcome:
        """Call it after the calibration has ended."""
        calibrator = self.calibrator
        assert calibrator.ended is not None
        return CalibrationOutcome(
            folder, calibrator.ended, calibrator.findings, calibrator.charts, log_problem
        )

    def _take_actions(self) -> None:
        while self.actions:
            self.carry_out(self.calibrator.take(self.actions.popleft()))


def result_of(task: EvaluationTask) -> object:
    """The task's result, or its exception: a failed evaluation does not end the calibration."""
    try:
        return task.run()
    except Exception as error:
        return error


def flight_start(plan: CalibrationPlan, context: CalibrationContext) -> recorder.FlightStart:
    """The first entry of the flight's log. A replay starts from it."""
    numbers = context.prior.pneumatics if context.prior else plan.config.pneumatics
    text = configuration_text(plan.config)
    return recorder.FlightStart(text, numbers, context.rig_text, context.stored)
