"""A calibration on the terminal: what is done and found, how far it is, and what the person is asked."""

from __future__ import annotations

import asyncio
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from flying_vines.calibration import calibrator
from flying_vines.calibration.calibrator import Ended, Question, Say, StageBegan, StageResult
from flying_vines.calibration.findings import Findings, MeasuredQuantity
from flying_vines.calibration.plan import CalibrationPlan

if TYPE_CHECKING:
    from flying_vines.calibration.diagnosis import Diagnosis

OUTCOMES = {
    "done": ("Done", "bold green"),
    "stopped": ("Stopped, and vented", "bold yellow"),
    "refused": ("Not begun", "bold red"),
}


class Walk:
    """Shows it; and asks, where somebody is to be `asked`."""

    def __init__(self, console: Console, asked: bool) -> None:
        self._console = console
        self._asked = asked
        columns = BarColumn(), TextColumn("{task.fields[left]}"), TextColumn("{task.description}")
        self._bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task = self._bar.add_task("", total=1.0, left="")
        self._answered: Callable[[str | None], None] | None = None
        self._told: dict[str, MeasuredQuantity] = {}
        self._paused = False
        self._typed = ""

    @contextmanager
    def under_way(self) -> Iterator[None]:
        """Within it the bar is there."""
        with self._bar:
            yield

    @contextmanager
    def typed(self) -> Iterator[None]:
        """Within it, in the event loop, lines that are typed are answers."""
        if not self._asked:
            yield
            return
        loop, number = asyncio.get_running_loop(), sys.stdin.fileno()
        loop.add_reader(number, self._read, number)
        try:
            yield
        finally:
            loop.remove_reader(number)

    def introduce(self, plan: CalibrationPlan) -> None:
        """What will be done, and what it takes."""
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
        for name in ("stage", "", "time", "bottle"):
            table.add_column(name, justify="right" if name in ("time", "bottle") else "left")
        for stage in plan.stages:
            air = f"{stage.air_kPa:.0f} kPa" if stage.air_kPa >= 0.5 else "–"
            table.add_row(stage.name, stage.does, _duration(stage.seconds), air)
        self._console.print(table)
        self._console.print(f"It {plan.summary()}.", style="bold")

    def ask(self, question: Question, answered: Callable[[str | None], None]) -> None:
        """Somebody who is there, or nobody."""
        if not self._asked:
            asyncio.get_running_loop().call_soon(answered, None)
            return
        self._bar.stop()
        self._paused = True
        self._console.print(Text(f"{question.text} ", style="bold magenta"), end="")
        self._answered = answered

    async def confirmed(self, text: str, stopped: asyncio.Event) -> bool:
        """Whether somebody who is asked presses Enter, before the calibration is `stopped`."""
        if not self._asked:
            return not stopped.is_set()
        self._console.print(Text(text, style="bold magenta"))
        pressed = asyncio.Event()
        self._answered = lambda line: (stopped if line is None else pressed).set()
        waiting = [asyncio.create_task(event.wait()) for event in (pressed, stopped)]
        await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        for task in waiting:
            task.cancel()
        self._answered = None
        return not stopped.is_set()

    def show(self, out: StageBegan | Say | StageResult | Ended) -> None:
        """One line, or a few."""
        say = self._bar.console.print
        match out:
            case StageBegan(stage, index, of):
                say(Text.assemble((f"{index + 1}/{of}  {stage.title}", "bold"), (f"  {stage.does}", "dim")))
            case Say(text):
                say(Text(f"     {text}"))
            case StageResult(_, findings, _):
                for finding in findings:
                    if _is_news(finding, self._told.get(finding.name)):
                        self._told[finding.name] = finding
                        say(_found(finding))
            case Ended(outcome, sentence):
                said, style = OUTCOMES[outcome]
                say(Text(f"{said}: {sentence}", style=style), soft_wrap=True)

    def progress(self, progress: calibrator.StageProgress) -> None:
        """On the bar."""
        left = _duration(progress.left_s)
        self._bar.update(self._task, completed=progress.share, left=left, description=progress.doing)

    def warn(self, text: str) -> None:
        """What a person should know of."""
        self._bar.console.print(Text(text, style="yellow"), soft_wrap=True)

    def found(self, findings: Findings) -> None:
        """All of it, in a table."""
        self._console.print(findings_table(findings))
        for note in notes(findings):
            self._console.print(Text(f"· {note}", style="yellow"))

    @contextmanager
    def working(self) -> Iterator[Callable[[str, float], None]]:
        """A bar while something long works, which tells it what it does and which share of all is done."""

        def told(step: str, share: float) -> None:
            self._bar.update(self._task, completed=share, left="", description=step)

        self._console.print("Looking for what else is in the recording: some minutes. Ctrl-C leaves it out.")
        with self._bar:
            yield told

    def diagnosis(self, found: Diagnosis) -> None:
        """In its own words, and what it is good for."""
        from flying_vines.identification.show import in_words

        verdict, unseen, say = found.verdict, found.verdict.held_out, self._console.print
        say(Text.assemble("\nDiagnosis of what was recorded: ", (in_words(verdict), "bold")))
        for named in verdict.named:
            for name, e in named.parameters.items():
                say(f"     {named.cause}  {name} {e.estimate:.4g} ({e.low:.4g} … {e.high:.4g})")
        say(
            f"     {verdict.confidence:.0%} sure; error on unseen data {unseen.nrmse_before:.2%} of the "
            f"range before, {unseen.nrmse_after:.2%} after, noise alone {unseen.noise_floor:.2%}"
        )
        if found.rig is not None and not found.helps:
            say("     What it names changes nothing of the cycles left: the profile does not name it.")
        self.at_last("Diagnosis", found.report)

    def firmware(self, wanted: Mapping[str, float], link: str, is_set: bool) -> None:
        """What is proposed for the firmware, and how to set it."""
        if not wanted:
            return
        values = " ".join(f"--set {name}={value:g}" for name, value in wanted.items())
        how = "kept there" if is_set else f"to keep it there: flying-vines link {link} {values}"
        self.at_last("Firmware", f"{', '.join(f'{name} {value:g}' for name, value in wanted.items())}; {how}")

    def at_last(self, what: str, where: object) -> None:
        """A file, or what else is left behind."""
        self._console.print(f"{what:9} {where}", soft_wrap=True)

    def _read(self, number: int) -> None:
        data = os.read(number, 4096)
        *lines, self._typed = (self._typed + data.decode(errors="replace")).split("\n")
        for line in lines:
            self._answer(line)
        if not data:
            asyncio.get_running_loop().remove_reader(number)
            self._answer(None)

    def _answer(self, line: str | None) -> None:
        answered, self._answered = self._answered, None
        if self._paused:
            self._bar.start()
            self._paused = False
        if answered is not None:
            answered(line)


def findings_table(findings: Findings) -> Table:
    """Quantity, believed, measured with its interval, change."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    table.add_column("quantity", overflow="fold")
    for name in ("believed", "measured", "95 % interval", "change"):
        table.add_column(name, justify="right")
    for finding in findings.findings:
        believed = "" if finding.believed is None else f"{finding.believed:.4g}"
        unit = f", {finding.unit}" if finding.unit else ""
        table.add_row(f"{finding.what}{unit}", believed, *measured(finding), change(finding))
    return table


def measured(finding: MeasuredQuantity) -> tuple[str, str]:
    """The value and its interval, with as many digits as the interval says that are known."""
    if finding.value is None:
        return "–", ""
    low, high = finding.low, finding.high
    if low is None or high is None:
        return f"{finding.value:.4g}", ""
    digits = _decimals(0.5 * (high - low))
    return f"{finding.value:.{digits}f}", f"{low:.{digits}f} … {high:.{digits}f}"


def change(finding: MeasuredQuantity) -> str:
    """Against what was believed; nothing where nothing was, or where the interval holds it."""
    value, believed = finding.value, finding.believed
    if value is None or believed is None:
        return ""
    if finding.low is not None and finding.high is not None and finding.low <= believed <= finding.high:
        return "as believed"
    return f"{value - believed:+.3g}" if believed == 0.0 else f"{value / believed - 1.0:+.1%}"


def _is_news(finding: MeasuredQuantity, told: MeasuredQuantity | None) -> bool:
    """Whether it says more than what was told: it is measured now, it is elsewhere, or twice as sure."""
    if told is None or told.value is None or finding.value is None:
        return told is None or told.value != finding.value
    if told.low is None or told.high is None or finding.low is None or finding.high is None:
        return False
    elsewhere = abs(finding.value - told.value) > max(0.1 * abs(told.value), told.high - told.low)
    return elsewhere or finding.high - finding.low < 0.5 * (told.high - told.low)


def _found(finding: MeasuredQuantity) -> Text:
    value, interval = measured(finding)
    if finding.value is None:
        return Text(f"     {finding.what}: {finding.note or 'not measured'}", style="yellow")
    line = Text.assemble(f"     {finding.what}  ", (f"{value} {finding.unit}".rstrip(), "bold cyan"))
    if interval:
        line.append(f"  ({interval})", style="dim")
    return line


def _decimals(half_width: float) -> int:
    """That show two digits of the uncertainty."""
    if not 0.0 < half_width < math.inf:
        return 3
    return min(9, max(0, 1 - math.floor(math.log10(half_width))))


def _duration(seconds: float) -> str:
    whole = max(0, round(seconds))
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"


def notes(findings: Findings) -> Sequence[str]:
    """What is to be known of the numbers."""
    noted = [f"{f.what}: {f.note}" for f in findings.findings if f.note]
    return (*noted, *findings.remarks)
