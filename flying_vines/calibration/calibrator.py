"""The machine that goes through a calibration: what happens comes in, what is to be asked and said goes out.

It reads no clock and opens nothing. It asks for movements as a person would, so the core's safety rules on
each of them; whatever ends it, the last thing that it asks for is to vent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from flying_vines.calibration.charts import Chart
from flying_vines.calibration.findings import Findings, MeasuredQuantity, Result
from flying_vines.calibration.plan import ANSWER_S, SETTLE_S, CalibrationPlan, Movement, Stage
from flying_vines.calibration.readings import Notebook
from flying_vines.calibration.work import StageRecording
from flying_vines.core.events import Action, Decision, Measured, Snapshot
from flying_vines.vine.intent import Asker, Intent, SetPressure, StartBench, StartProfile, VentVine

BY: Asker = "calibration"
BOARD_WITHIN_S = 15.0
"""It answers and tells its pressures, or there is nothing to calibrate."""
DECIDED_WITHIN_S = 2.0
LATE_S = 1.0
"""After a movement's time it is vented, whatever it does."""
DOWN_WITHIN_S = 15.0
DOWN_KPA = 1.0
"""Above the sensor's zero; less is vented."""
PERSON_WITHIN_S = 900.0
"""To swap a hose or to fill a bottle."""
SURE = {"levels": ("cv_volume_L", 0.04), "valve": ("evp_flow_resistance_kPa_s_per_SL", 0.05)}
"""A movement is repeated until half the interval of this is so small a share of it."""
_VENTED_STAGES = ("empty", "zero")

_ZERO_FAULT = "vine_zero"


@dataclass(frozen=True)
class OperatorRequest:
    """To be asked of the core, at once."""

    intent: Intent


@dataclass(frozen=True)
class Question:
    """To be asked of the person: to press Enter, or for an angle in degrees (Enter skips)."""

    number: int
    kind: Literal["enter", "angle"]
    text: str


@dataclass(frozen=True)
class Say:
    """A line for the person."""

    text: str


@dataclass(frozen=True)
class StageBegan:
    stage: Stage
    index: int
    of: int


@dataclass(frozen=True)
class Work:
    """To be done aside, for it takes CPU time; its value (or its exception) comes back by `worked`."""

    stage: Stage
    do: Callable[[], Result]


@dataclass(frozen=True)
class StageResult:
    """What a stage gave."""

    stage: Stage
    findings: tuple[MeasuredQuantity, ...]
    charts: tuple[Chart, ...]


@dataclass(frozen=True)
class Ended:
    """The last of all. "refused": nothing was moved."""

    outcome: Literal["done", "stopped", "refused"]
    sentence: str


Out = OperatorRequest | Question | Say | StageBegan | Work | StageResult | Ended


@dataclass(frozen=True)
class StageProgress:
    """How far it is."""

    stage: str
    title: str
    index: int
    of: int
    share: float
    """Of the whole, 0…1."""
    left_s: float
    """As planned, without repeats."""
    doing: str


class _Stopped(Exception):
    """It cannot go on; the text is for people."""


class Calibrator:
    """Feed it all that the core does, the time, and what the person says; do what it gives back, in order."""

    def __init__(self, plan: CalibrationPlan) -> None:
        self.plan = plan
        self.findings = Findings()
        self.ended: Ended | None = None
        self._charts: dict[str, Chart] = {}
        self._notebook = Notebook()
        self._out: list[Out] = []
        self._t = 0.0
        self._snapshot: Snapshot | None = None
        self._script: Generator[None] | None = None
        self._stage: Stage | None = None
        self._index = 0
        self._began_at = 0.0
        self._doing = "waiting for the board"
        self._decision: Decision | None = None
        self._question: Question | None = None
        self._answered = False
        self._answer: str | None = None
        self._work: Work | None = None
        self._first_row = 0
        """Of what is recorded of the bottle and the vine as they are now."""
        self._moved = False
        self._ready = False

    @property
    def charts(self) -> tuple[Chart, ...]:
        """Of all stages so far."""
        return tuple(self._charts.values())

    @property
    def progress(self) -> StageProgress:
        """For a bar."""
        stages = self.plan.stages
        stage = self._stage or stages[0]
        into_s = min(stage.seconds, max(0.0, self._t - self._began_at)) if self._stage else 0.0
        done_s = sum(each.seconds for each in stages[: self._index]) + into_s
        total_s = max(self.plan.seconds, 1e-9)
        over = self.ended is not None and self.ended.outcome == "done"
        share = 1.0 if over else min(1.0, done_s / total_s)
        left_s = 0.0 if self.ended else max(0.0, total_s - done_s)
        return StageProgress(
            stage.name, stage.title, self._index + 1, len(stages), share, left_s, self._doing
        )

    # What happens.

    def begin(self, t: float) -> list[Out]:
        """The core is up."""
        self._t = t
        self._script = self._go()
        return self._poke()

    def take(self, action: Action) -> list[Out]:
        """Anything that the core does."""
        if self.ended is not None:
            return []
        if isinstance(action, Measured):
            self._notebook.take(action.telemetry)
        elif isinstance(action, Decision):
            self._t = max(self._t, action.t)
            if action.trigger == BY:
                self._decision = action
            elif action.trigger == "failsafe":
                return self._end("stopped", action.reason)
            elif action.safety != "refused" and self._stage is not None:
                return self._end("stopped", f"somebody else asked for {action.intent} ({action.trigger})")
        return []

    def tick(self, t: float, snapshot: Snapshot) -> list[Out]:
        """Time passed; how the core stands."""
        if self.ended is not None:
            return []
        self._t, self._snapshot = t, snapshot
        if self._ready and (problem := self._problem(snapshot)):
            return self._end("stopped", problem)
        return self._poke()

    def answer(self, t: float, question: Question, text: str | None) -> list[Out]:
        """What the person says; None when nobody will say anything."""
        self._t = max(self._t, t)
        if self.ended is not None or question != self._question or self._answered:
            return []
        self._answered, self._answer = True, text
        return self._poke()

    def worked(self, t: float, work: Work, result: object) -> list[Out]:
        """What a piece of work came to: its value, or its exception."""
        self._t = max(self._t, t)
        if self.ended is not None or work is not self._work:
            return []
        self._work = None
        if not isinstance(result, Result):
            what = f"{work.stage.title}: what was recorded could not be evaluated: {result}"
            result = Result(remarks=(what,))
            self._out.append(Say(what))
        self.findings = self.findings.with_result(result)
        self._charts |= {chart.name: chart for chart in result.charts}
        self._out.append(StageResult(work.stage, result.findings, result.charts))
        return self._poke()

    def stop(self, t: float, why: str) -> list[Out]:
        """A person, or a loss outside the core, ends it."""
        self._t = max(self._t, t)
        return [] if self.ended is not None else self._end("stopped", why)

    # The script, which waits wherever it yields.

    def _go(self) -> Generator[None]:
        yield from self._meet_board()
        for index, stage in enumerate(self.plan.stages):
            yield from self._ask(StartBench())
            self._index, self._stage, self._began_at = index, stage, self._t
            self._doing = stage.does
            self._out.append(StageBegan(stage, index, len(self.plan.stages)))
            yield from self._do(stage)
        self._out.append(OperatorRequest(VentVine()))
        self._finish("done", "calibrated")

    def _do(self, stage: Stage) -> Generator[None]:
        match stage.name:
            case "empty":
                yield from self._enter("Let all air out of the bottle, leave it open, and press Enter")
                yield from self._rest_and_read(stage)
                yield from self._enter("Close the bottle, fill it, and press Enter")
                self._first_row = len(self._notebook)
            case "zero":
                yield from self._wait(SETTLE_S)
                yield from self._rest_and_read(replace(stage, rest_s=stage.rest_s - SETTLE_S))
                self._need_zero()
                self._need_air(self.plan.air_kPa)
            case "vessel":
                litres = self.plan.wish.vessel_L
                yield from self._enter(f"Put the vessel ({litres:g} L) in place of the vine, and press Enter")
                self._first_row = len(self._notebook)
                yield from self._wait(stage.rest_s)
                yield from self._move(stage.movements)
                yield from self._evaluate(stage)
                yield from self._enter("Put the vine back, and press Enter")
                self._first_row = len(self._notebook)
                yield from self._wait(stage.rest_s)
            case "angle" if stage.levels_kPa:
                yield from self._look_at_angles(stage)
                yield from self._evaluate(stage)
            case _:
                yield from self._wait(stage.rest_s)
                if not stage.movements:
                    yield from self._evaluate(stage)
                else:
                    yield from self._move_until_sure(stage)

    def _meet_board(self) -> Generator[None]:
        until = self._t + BOARD_WITHIN_S
        while not self._there():
            if self._t > until:
                problem = self._snapshot.firmware if self._snapshot else "does not answer"
                raise _Stopped(f"phloSAR {problem}")
            yield
        assert self._snapshot is not None
        if self._snapshot.armed:
            raise _Stopped("the vehicle is armed: disarm it, for this is done on the ground")
        if problem := self._problem(self._snapshot):
            raise _Stopped(problem)
        self._ready = True

    def _there(self) -> bool:
        now = self._snapshot
        return now is not None and now.firmware == "ready" and math.isfinite(now.cv_kPa)

    def _ask(self, intent: Intent) -> Generator[None]:
        """Ask the core, and wait for its ruling."""
        self._decision = None
        self._out.append(OperatorRequest(intent))
        until = self._t + DECIDED_WITHIN_S
        while self._decision is None:
            yield
            if self._t > until:
                raise _Stopped(f"nobody decided on {intent}")
        if self._decision.safety == "refused":
            raise _Stopped(f"{intent} was refused: {self._decision.reason}")

    def _wait(self, seconds: float) -> Generator[None]:
        until = self._t + seconds
        while self._t < until:
            yield

    def _rest_and_read(self, stage: Stage) -> Generator[None]:
        """What is read of a rest alone."""
        first = len(self._notebook)
        yield from self._wait(stage.rest_s)
        yield from self._evaluate(stage, first)

    def _move_until_sure(self, stage: Stage) -> Generator[None]:
        yield from self._move(stage.movements)
        yield from self._evaluate(stage)
        for _ in range(stage.most_again):
            if self._sure(stage):
                return
            if not self._holds(sum(move.air_kPa for move in stage.again)):
                self._out.append(Say(f"{stage.title}: not sure enough, but the bottle holds no more of it"))
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
        until = self._t + DOWN_WITHIN_S
        while self._cv_kPa() > DOWN_KPA:
            if self._t > until:
                raise _Stopped(f"the vine is vented and still reads {self._cv_kPa():.1f} kPa")
            yield
        yield from self._wait(self.plan.vented_s)

    def _cv_kPa(self) -> float:
        zero = self.findings.estimate("cv_zero_kPa")
        assert self._snapshot is not None
        return self._snapshot.cv_kPa - (zero.value if zero else 0.0)

    def _enter(self, text: str) -> Generator[None]:
        yield from self._ask_person("enter", text, PERSON_WITHIN_S)
        if self._answer is None:
            raise _Stopped("nobody answered")

    def _ask_person(self, kind: Literal["enter", "angle"], text: str, within_s: float) -> Generator[None]:
        """Ask, and wait; `_answer` is None when nobody answered."""
        self._question = Question(self._question.number + 1 if self._question else 1, kind, text)
        self._answered, self._answer = False, None
        self._out.append(self._question)
        until = self._t + within_s
        while not self._answered and self._t < until:
            yield
        self._answered = True

    def _look_at_angles(self, stage: Stage) -> Generator[None]:
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
                    self._out.append(Say("Bend: nobody says what is seen; the vine is vented"))
                    yield from self._vent()
                    return
                if (angle := _angle_deg(self._answer)) is None:
                    self._out.append(Say(f"'{self._answer.strip()}' is no angle in degrees"))
                    continue
                break
            if not math.isnan(angle):
                self.findings = replace(self.findings, pairs=(*self.findings.pairs, (held_kPa, angle)))
        yield from self._vent()

    def _evaluate(self, stage: Stage, first: int | None = None) -> Generator[None]:
        """Let what was recorded be evaluated, and wait for it."""
        assert self._snapshot is not None
        recorded = StageRecording(
            self.plan,
            stage.name,
            self._notebook.readings(self._first_row if first is None else first),
            self.findings,
            self._snapshot.ambient_kPa,
        )
        work = self._work = Work(stage, recorded.result)
        self._out.append(work)
        while self._work is not None:
            yield

    def _sure(self, stage: Stage) -> bool:
        if stage.name not in SURE:
            return True
        name, share = SURE[stage.name]
        found = self.findings.estimate(name)
        return found is not None and found.high - found.value <= share * found.value

    def _need_zero(self) -> None:
        """Beyond what a sound sensor may be off, the limits mean nothing."""
        zero = self.findings.estimate("cv_zero_kPa")
        if zero is not None and abs(zero.value) > self.plan.believed.checks.zero_kPa:
            raise _Stopped(
                f"the vented vine reads {zero.value:.1f} kPa: set cv_zero_kPa of the firmware as proposed, "
                "and calibrate again"
            )

    # Air.

    def _holds(self, air_kPa: float) -> bool:
        assert self._snapshot is not None
        return self._snapshot.reservoir_kPa >= self._least_kPa(air_kPa)

    def _least_kPa(self, air_kPa: float) -> float:
        return air_kPa + self.plan.top_kPa + self.plan.believed.interlocks.reserve_kPa

    def _need_air(self, air_kPa: float) -> None:
        if not self._holds(air_kPa):
            assert self._snapshot is not None
            has_kPa, needs_kPa = self._snapshot.reservoir_kPa, self._least_kPa(air_kPa)
            raise _Stopped(f"the bottle holds {has_kPa:.0f} kPa, and this needs {needs_kPa:.0f}: fill it")

    # Ending.

    def _problem(self, now: Snapshot) -> str:
        """Why it cannot go on, or nothing. A sensor's zero is what the first stages are for."""
        if now.firmware != "ready":
            return f"phloSAR {now.firmware}"
        wrong = dict(now.safe_state)
        if self._stage is None or self._stage.name in _VENTED_STAGES:
            wrong.pop(_ZERO_FAULT, None)
        return "; ".join(wrong.values())

    def _poke(self) -> list[Out]:
        """Let the script go on as far as it can."""
        assert self._script is not None
        try:
            next(self._script)
        except StopIteration:
            pass
        except _Stopped as stopped:
            return self._end("stopped", str(stopped))
        return self._given()

    def _end(self, outcome: Literal["stopped"], why: str) -> list[Out]:
        stage = f"{self._stage.title}: " if self._stage else ""
        self._out.append(OperatorRequest(VentVine()))
        self._finish(outcome if self._moved else "refused", f"{stage}{why}")
        return self._given()

    def _finish(self, outcome: Literal["done", "stopped", "refused"], sentence: str) -> None:
        self.ended = Ended(outcome, sentence)
        self._out.append(self.ended)

    def _given(self) -> list[Out]:
        out, self._out = self._out, []
        return out


def _angle_deg(text: str) -> float | None:
    """NaN for one that is skipped; None for what is no angle."""
    if not text.strip():
        return math.nan
    try:
        angle = float(text.strip().rstrip("°").replace(",", "."))
    except ValueError:
        return None
    return angle if math.isfinite(angle) else None
