"""A calibration on the terminal: its plan, progress, results and questions."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from flying_vines.calibration.calibrator import (
    CalibrationProgress,
    Ended,
    Message,
    Question,
    StageBegan,
    StageResult,
)
from flying_vines.calibration.findings import Findings, MeasuredQuantity
from flying_vines.calibration.plan import CalibrationPlan

if TYPE_CHECKING:
    from pathlib import Path

    from flying_vines.identification.verdict import Verdict

OUTCOMES = {
    "done": ("Done", "bold green"),
    "stopped": ("Stopped, and vented", "bold yellow"),
    "refused": ("Not started", "bold red"),
}


class CalibrationTerminal:
    """Shows a calibration, and asks the person questions if it is `interactive`."""

    def __init__(self, console: Console, interactive: bool) -> None:
        self._console = console
        self._interactive = interactive
        columns = BarColumn(), TextColumn("{task.fields[left]}"), TextColumn("{task.description}")
        self._bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task = self._bar.add_task("", total=1.0, left="")
        self._answered: Callable[[str | None], None] | None = None
        self._shown: dict[str, MeasuredQuantity] = {}
        self._paused = False
        self._typed = ""

    @contextmanager
    def live(self) -> Iterator[None]:
        """Show the progress bar in this context."""
        with self._bar:
            yield

    @contextmanager
    def typed(self) -> Iterator[None]:
        """Take typed lines as answers in this context. Needs a running event loop."""
        if not self._interactive:
            yield
            return
        loop, number = asyncio.get_running_loop(), sys.stdin.fileno()
        loop.add_reader(number, self._read, number)
        try:
            yield
        finally:
            loop.remove_reader(number)

    def introduce(self, plan: CalibrationPlan) -> None:
        """Show the stages with their time and air."""
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
        for name in ("stage", "", "time", "reservoir"):
            table.add_column(name, justify="right" if name in ("time", "reservoir") else "left")
        for stage in plan.stages:
            air = f"{stage.air_kPa:.0f} kPa" if stage.air_kPa >= 0.5 else "–"
            table.add_row(stage.name, stage.does, _duration(stage.seconds), air)
        self._console.print(table)
        self._console.print(f"It {plan.summary()}.", style="bold")

    def ask(self, question: Question, answered: Callable[[str | None], None]) -> None:
        """Ask the person; `answered` is called once, now or later, with None if nobody will answer."""
        if not self._interactive:
            asyncio.get_running_loop().call_soon(answered, None)
            return
        self._bar.stop()
        self._paused = True
        self._console.print(Text(f"{question.text} ", style="bold magenta"), end="")
        self._answered = answered

    async def confirmed(self, text: str, stopped: asyncio.Event) -> bool:
        """True if the person presses Enter before the calibration is `stopped`, or if nobody is asked."""
        if not self._interactive:
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

    def show(self, output: StageBegan | Message | StageResult | Ended) -> None:
        """Print an output of the calibrator."""
        say = self._bar.console.print
        match output:
            case StageBegan(stage, index, of):
                say(Text.assemble((f"{index + 1}/{of}  {stage.title}", "bold"), (f"  {stage.does}", "dim")))
            case Message(text):
                say(Text(f"     {text}"))
            case StageResult(_, findings):
                for finding in findings:
                    if _is_news(finding, self._shown.get(finding.name)):
                        self._shown[finding.name] = finding
                        say(_found(finding))
            case Ended(outcome, sentence):
                word, style = OUTCOMES[outcome]
                say(Text(f"{word}: {sentence}", style=style), soft_wrap=True)

    def progress(self, progress: CalibrationProgress) -> None:
        """Update the bar."""
        left = _duration(progress.left_s)
        self._bar.update(self._task, completed=progress.share, left=left, description=progress.doing)

    def warn(self, text: str) -> None:
        self._bar.console.print(Text(text, style="yellow"), soft_wrap=True)

    def results(self, findings: Findings) -> None:
        """Show all quantities and notes."""
        self._console.print(findings_table(findings))
        for note in findings.notes():
            self._console.print(Text(f"· {note}", style="yellow"))

    @contextmanager
    def working(self) -> Iterator[Callable[[str, float], None]]:
        """In this context a bar shows the progress of a diagnosis: its step, and the share that is done."""

        def update(step: str, share: float) -> None:
            self._bar.update(self._task, completed=share, left="", description=step)

        self._console.print("Diagnosis of the recording: some minutes. Ctrl-C skips it.")
        with self._bar:
            yield update

    def diagnosis(self, verdict: Verdict, report: Path, helps: bool) -> None:
        """Show the verdict; `helps`: its causes improve the cycles left."""
        from flying_vines.identification.show import in_words

        unseen, say = verdict.held_out, self._console.print
        say(Text.assemble("\nDiagnosis of the recording: ", (in_words(verdict), "bold")))
        for named in verdict.named:
            for name, e in named.parameters.items():
                say(f"     {named.cause}  {name} {e.estimate:.4g} ({e.low:.4g} … {e.high:.4g})")
        say(
            f"     confidence {verdict.confidence:.0%}; error on unseen data {unseen.nrmse_before:.2%} of "
            f"the range before, {unseen.nrmse_after:.2%} after; noise alone {unseen.noise_floor:.2%}"
        )
        if verdict.named and not helps:
            say(
                "     The named causes do not improve the cycles left. "
                "So the configuration does not name rig.toml."
            )
        self.line("Diagnosis", report)

    def firmware(self, wanted: Mapping[str, float], link: str, is_set: bool) -> None:
        """Show the proposed settings, and how to save them."""
        if not wanted:
            return
        values = " ".join(f"--set {name}={value:g}" for name, value in wanted.items())
        how = "saved" if is_set else f"to save: flying-vines link {link} {values}"
        self.line("Firmware", f"{', '.join(f'{name} {value:g}' for name, value in wanted.items())}; {how}")

    def line(self, what: str, where: object) -> None:
        """A line of the summary at the end, such as the path of a file."""
        self._console.print(f"{what:13} {where}", soft_wrap=True)

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
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    table.add_column("quantity", overflow="fold")
    for name in ("assumed", "measured", "95 % interval", "change"):
        table.add_column(name, justify="right")
    for finding in findings.findings:
        assumed = "" if finding.assumed is None else f"{finding.assumed:.4g}"
        unit = f", {finding.unit}" if finding.unit else ""
        table.add_row(f"{finding.what}{unit}", assumed, *finding.texts(), finding.change())
    return table


def _is_news(finding: MeasuredQuantity, shown: MeasuredQuantity | None) -> bool:
    """True if the value is measured for the first time, clearly different from the shown one, or twice as
    precise."""
    if shown is None or shown.interval is None or finding.interval is None:
        return shown is None or shown.value != finding.value
    (before, low_before, high_before), (now, low, high) = shown.interval, finding.interval
    different = abs(now - before) > max(0.1 * abs(before), high_before - low_before)
    return different or high - low < 0.5 * (high_before - low_before)


def _found(finding: MeasuredQuantity) -> Text:
    value, interval = finding.texts()
    if finding.value is None:
        return Text(f"     {finding.what}: {finding.note or 'not measured'}", style="yellow")
    line = Text.assemble(f"     {finding.what}  ", (f"{value} {finding.unit}".rstrip(), "bold cyan"))
    if interval:
        line.append(f"  ({interval})", style="dim")
    return line


def _duration(seconds: float) -> str:
    whole = max(0, round(seconds))
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"
