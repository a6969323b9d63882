"""The state machine of a calibration: events come in, requests and messages go out.

It reads no clock and opens no port. It asks the core for movements as a person would, so the core's safety
rules apply to each of them. Its last request is always to vent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from flying_vines.calibration.evaluation import StageRecording
from flying_vines.calibration.findings import Findings, MeasuredQuantity
from flying_vines.calibration.plan import ANSWER_S, SETTLE_S, CalibrationPlan, Movement, Stage
from flying_vines.calibration.readings import ReadingsBuffer
from flying_vines.core.events import Action, Decision, Measured
from flying_vines.core.snapshot import Snapshot
from flying_vines.vine.intent import Asker, Intent, SetPressure, StartBench, StartProfile, VentVine

BY: Asker = "calibration"
BOARD_TIMEOUT_S = 15.0
"""Maximum time until the board answers and sends pressures."""
DECISION_TIMEOUT_S = 2.0
LATE_S = 1.0
"""Added to a movement's time before the vine is vented."""
VENT_TIMEOUT_S = 15.0
VENTED_KPA = 1.0
"""Below this pressure the vine counts as vented."""
PERSON_TIMEOUT_S = 900.0
"""Maximum time for a person to change a hose or to fill a reservoir."""
PRECISION = {"levels": ("cv_volume_L", 0.04), "valve": ("evp_flow_resistance_kPa_s_per_SL", 0.05)}
"""A stage repeats until half the 95 % interval of this quantity is at most this share of its value."""
_VENTED_STAGES = ("empty", "zero")

_ZERO_FAULT = "vine_zero"


@dataclass(frozen=True)
class OperatorRequest:
    """A request to pass to the core at once."""

    intent: Intent


@dataclass(frozen=True)
class Question:
    """Asks the person to press Enter, or to type an angle in degrees (Enter alone skips the angle)."""

    number: int
    kind: Literal["enter", "angle"]
    text: str


@dataclass(frozen=True)
class Message:
    """One line for the person."""

    text: str


@dataclass(frozen=True)
class StageBegan:
    stage: Stage
    index: int
    of: int


@dataclass(frozen=True)
class EvaluationTask:
    """Work for the background, because it takes CPU time. Pass its result or exception to `evaluated`."""

    stage: Stage
    run: Callable[[], Findings]


@dataclass(frozen=True)
class StageResult:
    stage: Stage
    findings: tuple[MeasuredQuantity, ...]


@dataclass(frozen=True)
class Ended:
    """The last output. "refused": nothing was moved."""

    outcome: Literal["done", "stopped", "refused"]
    sentence: str


Output = OperatorRequest | Question | Message | StageBegan | EvaluationTask | StageResult | Ended


@dataclass(frozen=True)
class CalibrationProgress:
    share: float
    """Done share of the whole calibration, 0…1."""
    left_s: float
    """Remaining time, as planned without repeats."""
    doing: str


class _Stopped(Exception):
    """Raised to end the calibration; the text is for the person."""


class Calibrator:
    """Feed it all actions of the core, the time and the answers; carry out its outputs in order."""

    def __init__(self, plan: CalibrationPlan) -> None:
        self.plan = plan
        self.findings = Findings()
        self.ended: Ended | None = None
        self._buffer = ReadingsBuffer()
        self._out: list[Output] = []
        self._t = 0.0
        self._snapshot: Snapshot | None = None
        self._steps: Generator[None] | None = None
        self._stage: Stage | None = None
        self._index = 0
        self._began_at = 0.0
        self._doing = "waiting for the board"
        self._decision: Decision | None = None
        self._question: Question | None = None
        self._answered = False
        self._answer: str | None = None
        self._task: EvaluationTask | None = None
        self._first_row = 0
        """First row since the reservoir or the vine was last changed."""
        self._moved = False
        self._ready = False

    @property
    def progress(self) -> CalibrationProgress:
        done_s = sum(stage.seconds for stage in self.plan.stages[: self._index])
        if self._stage:
            done_s += min(self._stage.seconds, max(0.0, self._t - self._began_at))
        total_s = max(self.plan.seconds, 1e-9)
        over = self.ended is not None and self.ended.outcome == "done"
        share = 1.0 if over else min(1.0, done_s / total_s)
        left_s = 0.0 if self.ended else max(0.0, total_s - done_s)
        return CalibrationProgress(share, left_s, self._doing)

    def cv_kPa(self, snapshot: Snapshot) -> float:
        """The vine's pressure, less the zero of its sensor if that is measured."""
        zero = self.findings.estimate("cv_zero_kPa")
        return snapshot.cv_kPa - (zero.value if zero else 0.0)

    def vented(self, snapshot: Snapshot) -> bool:
        """True if the core has vented the vine, and its pressure is low or unknown."""
        return snapshot.doing == "vented" and not self.cv_kPa(snapshot) >= VENTED_KPA

    # Inputs.

    def begin(self, t: float) -> list[Output]:
        """Begin. The core must run already."""
        self._t = t
        self._steps = self._procedure()
        return self._advance()

    def take(self, action: Action) -> list[Output]:
        """Take in any action of the core."""
        if self.ended is not None:
            return []
        if isinstance(action, Measured):
            self._buffer.append(action.telemetry)
        elif isinstance(action, Decision):
            self._t = max(self._t, action.t)
            if action.trigger == BY:
                self._decision = action
            elif action.trigger == "failsafe":
                return self._end("stopped", action.reason)
            elif action.safety != "refused" and self._stage is not None:
                return self._end("stopped", f"another source asked for {action.intent} ({action.trigger})")
        return []

    def tick(self, t: float, snapshot: Snapshot) -> list[Output]:
        """Time has passed; `snapshot` is the core's present state."""
        if self.ended is not None:
            return []
        self._t, self._snapshot = t, snapshot
        if self._ready and (problem := self._problem(snapshot)):
            return self._end("stopped", problem)
        return self._advance()

    def answer(self, t: float, question: Question, text: str | None) -> list[Output]:
        """The person's answer; None if nobody answers."""
        self._t = max(self._t, t)
        if self.ended is not None or question != self._question or self._answered:
            return []
        self._answered, self._answer = True, text
        return self._advance()

    def evaluated(self, t: float, task: EvaluationTask, result: object) -> list[Output]:
        """The result of an evaluation, or its exception."""
        self._t = max(self._t, t)
        if self.ended is not None or task is not self._task:
            return []
        self._task = None
        if not isinstance(result, Findings):
            what = f"{task.stage.title}: the recording could not be evaluated: {result}"
            result = Findings(remarks=(what,))
            self._out.append(Message(what))
        self.findings = self.findings.renewed_by(result)
        self._out.append(StageResult(task.stage, result.findings))
        return self._advance()

    def stop(self, t: float, why: str) -> list[Output]:
        """End the calibration for a reason outside the core."""
        self._t = max(self._t, t)
        return [] if self.ended is not None else self._end("stopped", why)

    # The procedure: a generator that yields wherever it has to wait.

    def _procedure(self) -> Generator[None]:
        yield from self._wait_for_board()
        for index, stage in enumerate(self.plan.stages):
            yield from self._ask(StartBench())
            self._index, self._stage, self._began_at = index, stage, self._t
            self._doing = stage.does
            self._out.append(StageBegan(stage, index, len(self.plan.stages)))
            yield from self._run_stage(stage)
        self._out.append(OperatorRequest(VentVine()))
        self._finish("done", "calibrated")

    def _run_stage(self, stage: Stage) -> Generator[None]:
        match stage.name:
            case "empty":
                yield from self._enter("Let all air out of the reservoir, leave it open, and press Enter")
                yield from self._rest_and_read(stage)
                yield from self._enter("Close the reservoir, fill it, and press Enter")
                self._first_row = len(self._buffer)
            case "zero":
                yield from self._wait(SETTLE_S)
                yield from self._rest_and_read(replace(stage, rest_s=stage.rest_s - SETTLE_S))
                self._need_zero()
                self._need_air(self.plan.air_kPa)
            case "vessel":
                litres = self.plan.request.vessel_L
                yield from self._enter(f"Put the vessel ({litres:g} L) in place of the vine, and press Enter")
                self._first_row = len(self._buffer)
                yield from self._wait(stage.rest_s)
                yield from self._move(stage.movements)
                yield from self._evaluate(stage)
                yield from self._enter("Put the vine back, and press Enter")
                self._first_row = len(self._buffer)
                yield from self._wait(stage.rest_s)
            case "angle" if stage.levels_kPa:
                yield from self._ask_angles(stage)
                yield from self._evaluate(stage)
            case _:
                yield from self._wait(stage.rest_s)
                if not stage.movements:
                    yield from self._evaluate(stage)
                else:
                    yield from self._move_until_precise(stage)

    def _wait_for_board(self) -> Generator[None]:
        until = self._t + BOARD_TIMEOUT_S
        while not self._board_ready():
            if self._t > until:
                raise _Stopped(self._why_not_ready())
            yield
        assert self._snapshot is not None
        if self._snapshot.armed:
            raise _Stopped("the vehicle is armed; disarm it, and calibrate on the ground")
        if problem := self._problem(self._snapshot):
            raise _Stopped(problem)
        self._ready = True

    def _board_ready(self) -> bool:
        now = self._snapshot
        return now is not None and now.firmware == "ready" and math.isfinite(now.cv_kPa)

    def _why_not_ready(self) -> str:
        now = self._snapshot
        if now is None or now.firmware != "ready":
            return f"phloSAR {now.firmware if now else 'does not answer'}"
        known = self._problem(now)
        because = f" ({known})" if known else ""
        return (
            f"phloSAR answers, but sends no pressure of the vine{because}: try another cable, or flash its "
            "firmware again"
        )

    def _ask(self, intent: Intent) -> Generator[None]:
        """Ask the core, and wait for its decision."""
        self._decision = None
        self._out.append(OperatorRequest(intent))
        until = self._t + DECISION_TIMEOUT_S
        while self._decision is None:
            yield
            if self._t > until:
                raise _Stopped(f"the core did not decide on {intent}")
        if self._decision.safety == "refused":
            raise _Stopped(f"{intent} was refused: {self._decision.reason}")

    def _wait(self, seconds: float) -> Generator[None]:
        until = self._t + seconds
        while self._t < until:
            yield

    def _rest_and_read(self, stage: Stage) -> Generator[None]:
        """Rest, and evaluate only the readings of this rest."""
        first = len(self._buffer)
        yield from self._wait(stage.rest_s)
        yield from self._evaluate(stage, first)

    def _move_until_precise(self, stage: Stage) -> Generator[None]:
        yield from self._move(stage.movements)
        yield from self._evaluate(stage)
        for _ in range(stage.max_repeats):
            if self._precise(stage):
                return
            if not self._air_lasts(sum(move.air_kPa for move in stage.again)):
                self._out.append(
                    Message(f"{stage.title}: not precise enough, and the reservoir has no air for a repeat")
                )
                return
            self._doing = f"{stage.does}, again"
            yield from self._move(stage.again)
            yield from self._evaluate(stage)

    def _move(self, movements: Sequence[Movement]) -> Generator[None]:
        self._need_air(sum(move.air_kPa for move in movements))
        for movement in movements:
            self._moved = True
            yield from self._ask(StartProfile(movement.profile))
            yield from self._wait(movement.seconds + LATE_S)
            yield from self._vent()

    def _vent(self) -> Generator[None]:
        yield from self._ask(VentVine())
        until = self._t + VENT_TIMEOUT_S
        while self._cv_kPa() > VENTED_KPA:
            if self._t > until:
                raise _Stopped(f"the vine is vented and still reads {self._cv_kPa():.1f} kPa")
            yield
        yield from self._wait(self.plan.hold_s)

    def _cv_kPa(self) -> float:
        assert self._snapshot is not None
        return self.cv_kPa(self._snapshot)

    def _enter(self, text: str) -> Generator[None]:
        yield from self._ask_person("enter", text, PERSON_TIMEOUT_S)
        if self._answer is None:
            raise _Stopped("nobody answered")

    def _ask_person(self, kind: Literal["enter", "angle"], text: str, timeout_s: float) -> Generator[None]:
        """Ask, and wait; then `_answer` is None if nobody has answered."""
        self._question = Question(self._question.number + 1 if self._question else 1, kind, text)
        self._answered, self._answer = False, None
        self._out.append(self._question)
        until = self._t + timeout_s
        while not self._answered and self._t < until:
            yield
        self._answered = True

    def _ask_angles(self, stage: Stage) -> Generator[None]:
        self._need_air(stage.air_kPa)
        self._moved = True
        for level in stage.levels_kPa:
            yield from self._ask(SetPressure(level) if level > 0.0 else VentVine())
            yield from self._wait(self.plan.hold_s)
            held_kPa = self._cv_kPa()
            while True:
                text = f"{held_kPa:.1f} kPa: which angle, in degrees?"
                yield from self._ask_person("angle", text, ANSWER_S)
                if self._answer is None:
                    self._out.append(Message("Bend: no answer; the vine is vented"))
                    yield from self._vent()
                    return
                if (angle := _angle_deg(self._answer)) is None:
                    self._out.append(Message(f"'{self._answer.strip()}' is not an angle in degrees"))
                    continue
                break
            if not math.isnan(angle):
                self.findings = replace(self.findings, pairs=(*self.findings.pairs, (held_kPa, angle)))
        yield from self._vent()

    def _evaluate(self, stage: Stage, first: int | None = None) -> Generator[None]:
        """Evaluate the recording in the background, and wait for the result."""
        assert self._snapshot is not None
        recorded = StageRecording(
            self.plan,
            stage.name,
            self._buffer.readings(self._first_row if first is None else first),
            self.findings,
            self._snapshot.ambient_kPa,
        )
        task = self._task = EvaluationTask(stage, recorded.result)
        self._out.append(task)
        while self._task is not None:
            yield

    def _precise(self, stage: Stage) -> bool:
        if stage.name not in PRECISION:
            return True
        name, share = PRECISION[stage.name]
        found = self.findings.estimate(name)
        return found is not None and found.high - found.value <= share * found.value

    def _need_zero(self) -> None:
        """Stop if the zero is above `checks.zero_kPa`: the pressure limits would not protect the vine."""
        zero = self.findings.estimate("cv_zero_kPa")
        if zero is not None and abs(zero.value) > self.plan.user_config.checks.zero_kPa:
            raise _Stopped(
                f"the vented vine reads {zero.value:.1f} kPa: set cv_zero_kPa of the firmware as proposed, "
                "and calibrate again"
            )

    # Air.

    def _air_lasts(self, air_kPa: float) -> bool:
        assert self._snapshot is not None
        return self._snapshot.reservoir_kPa >= self._needed_kPa(air_kPa)

    def _needed_kPa(self, air_kPa: float) -> float:
        return air_kPa + self.plan.top_kPa + self.plan.user_config.interlocks.reserve_kPa

    def _need_air(self, air_kPa: float) -> None:
        if not self._air_lasts(air_kPa):
            assert self._snapshot is not None
            has_kPa, needs_kPa = self._snapshot.reservoir_kPa, self._needed_kPa(air_kPa)
            raise _Stopped(f"the reservoir holds {has_kPa:.0f} kPa, but {needs_kPa:.0f} are needed: fill it")

    # Ending.

    def _problem(self, now: Snapshot) -> str:
        """The reason why the calibration cannot go on; empty if it can.

        Until the zero has been measured, a wrong zero is no reason.
        """
        if now.firmware != "ready":
            return f"phloSAR {now.firmware}"
        wrong = dict(now.safe_state)
        if self._stage is None or self._stage.name in _VENTED_STAGES:
            wrong.pop(_ZERO_FAULT, None)
        return "; ".join(wrong.values())

    def _advance(self) -> list[Output]:
        """Continue the procedure until it has to wait."""
        assert self._steps is not None
        try:
            next(self._steps)
        except StopIteration:
            pass
        except _Stopped as stopped:
            return self._end("stopped", str(stopped))
        return self._collected()

    def _end(self, outcome: Literal["stopped"], why: str) -> list[Output]:
        stage = f"{self._stage.title}: " if self._stage else ""
        self._out.append(OperatorRequest(VentVine()))
        self._finish(outcome if self._moved else "refused", f"{stage}{why}")
        return self._collected()

    def _finish(self, outcome: Literal["done", "stopped", "refused"], sentence: str) -> None:
        self.ended = Ended(outcome, sentence)
        self._out.append(self.ended)

    def _collected(self) -> list[Output]:
        out, self._out = self._out, []
        return out


def _angle_deg(text: str) -> float | None:
    """NaN for an empty text, which skips the angle; None if the text is not an angle."""
    if not text.strip():
        return math.nan
    try:
        angle = float(text.strip().rstrip("°").replace(",", "."))
    except ValueError:
        return None
    return angle if math.isfinite(angle) else None
