"""Between the calibrator and whatever runs the core: hears, tells, and has done what is wanted."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

from flying_vines.calibration.calibrator import (
    Calibrator,
    Ended,
    OperatorRequest,
    Out,
    Question,
    Say,
    StageBegan,
    StageProgress,
    StageResult,
    Work,
)
from flying_vines.calibration.charts import Chart
from flying_vines.calibration.findings import Findings
from flying_vines.calibration.known import KnownBeforehand
from flying_vines.calibration.plan import CalibrationPlan
from flying_vines.config.config_text import profile_text
from flying_vines.core.events import Action, Snapshot
from flying_vines.record import recorder
from flying_vines.vine.intent import Intent

STEP_S = 0.02
VENTS_WITHIN_S = 5.0
VENTED_KPA = 1.0
INTERRUPTED = "interrupted"


class Beholder(Protocol):
    """Whoever is shown how it goes."""

    def show(self, out: StageBegan | Say | StageResult | Ended) -> None:
        """Something happened."""

    def progress(self, progress: StageProgress) -> None:
        """How far it is, some fifty times a second of the rig's."""


class Conducted(NamedTuple):
    """What came of a calibration."""

    folder: Path
    """Of its flight."""
    ended: Ended
    findings: Findings
    charts: tuple[Chart, ...]
    log_problem: str
    """A sentence, where the log ended before its time."""


@dataclass
class Conductor:
    """`actions` are those of the core that the calibrator has not heard of yet, for the edge to put there."""

    calibrator: Calibrator
    beholder: Beholder
    ask: Callable[[Intent], None]
    question: Callable[[Question], None]
    work: Callable[[Work], None]
    actions: deque[Action] = field(default_factory=deque)
    _outs: deque[Out] = field(default_factory=deque)
    """Of which the first is being carried out."""

    def live(self, t: float, snapshot: Snapshot) -> None:
        """Hear of all that happened until `t`, and let time pass."""
        self._hear()
        self.carry_out(self.calibrator.tick(t, snapshot))
        self._hear()
        self.beholder.progress(self.calibrator.progress)

    def carry_out(self, outs: Sequence[Out]) -> None:
        """In order; what comes of it comes after them."""
        self._outs.extend(outs)
        if len(self._outs) > len(outs):
            return
        while self._outs:
            match self._outs[0]:
                case OperatorRequest(intent):
                    self.ask(intent)
                case Question() as asked:
                    self.question(asked)
                case Work() as asked:
                    self.work(asked)
                case told:
                    self.beholder.show(told)
            self._outs.popleft()

    def result(self, folder: Path, log_problem: str) -> Conducted:
        """Of a calibration that has ended."""
        calibrator = self.calibrator
        assert calibrator.ended is not None
        return Conducted(folder, calibrator.ended, calibrator.findings, calibrator.charts, log_problem)

    def _hear(self) -> None:
        while self.actions:
            self.carry_out(self.calibrator.take(self.actions.popleft()))


def done(work: Work) -> object:
    """Its result, or what went wrong with it: that ends no more than its stage."""
    try:
        return work.do()
    except Exception as error:
        return error


def vented(snapshot: Snapshot) -> bool:
    """Whether the vine is, or nobody knows how it is."""
    return snapshot.doing == "vented" and not snapshot.cv_kPa >= VENTED_KPA


def began(plan: CalibrationPlan, known: KnownBeforehand) -> recorder.FlightStart:
    """With what the flight's log begins, so that it can be replayed."""
    numbers = known.belief.pneumatics if known.belief else plan.config.pneumatics
    return recorder.FlightStart(profile_text(plan.config), numbers, known.rig_text, disarmed=known.disarmed)
