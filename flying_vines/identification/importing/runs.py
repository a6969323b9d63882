"""From a foreign table to recorded runs and a rig: the guess, what is missing, and the case folder.

proposal = propose(path, read_answers(answers_path(path)))
if not proposal.missing:
    write_case([proposal], folder)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
from rich.console import Console
from rich.table import Table

from flying_vines.config.toml_edit import table_lines
from flying_vines.identification.case import MIN_S, MIN_SAMPLES, RIG, Case, read_case
from flying_vines.identification.importing.answers_file import (
    Answers,
    ImportQuestion,
    answers_path,
    missing_line,
    read_answers,
)
from flying_vines.identification.importing.columns import IGNORED, QUANTITIES, ImportedColumn, guess_columns
from flying_vines.identification.importing.layout import ForeignTable, read_foreign
from flying_vines.identification.importing.rig_guess import PRESSURES, Run, fall_s, from_ambient, rig_tables
from flying_vines.identification.importing.units import parse_unit, psi_instead
from flying_vines.identification.noise import is_spike
from flying_vines.identification.recording import CaseError, counted, has_header
from flying_vines.physics.arrays import Array
from flying_vines.physics.gas import STANDARD_PRESSURE_KPA

_CASE_COLUMNS = {
    "time": "time_s",
    "command_kPa": "command_kPa",
    "evp_opening": "evp_opening",
    "dvp_opening": "dvp_opening",
    "solenoid": "solenoid",
    "cv_pressure": "cv_pressure_kPa",
    "reservoir_pressure": "reservoir_pressure_kPa",
    "ambient_pressure": "ambient_pressure_kPa",
    "ambient_temperature": "ambient_temperature_C",
    "after_gap": "after_gap",
}
_VALVES = ("evp_opening", "dvp_opening", "solenoid")
_MAX_VALVE_S = 3.0
"""Maximum time constant of a fall through an opened outlet; a slower fall is a leak."""
_VACUUM_KPA = 130.0
"""No reading is further below ambient pressure, even with a sensor offset."""
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks", "|": "bars"}
_EPOCH_S = 1e8
"""If the first time is larger, it is a date, and the run's time then starts at 0."""


@dataclass(frozen=True)
class Proposal:
    """How a file would be imported."""

    path: Path
    table: ForeignTable
    answers: Answers
    """Complete except for `questions`."""
    questions: tuple[ImportQuestion, ...]
    """Questions to the user; some have a guess."""
    notes: tuple[str, ...]
    runs: Mapping[str, Run]
    """By name."""

    @property
    def missing(self) -> tuple[ImportQuestion, ...]:
        """Questions without a guess."""
        return tuple(question for question in self.questions if not question.guess)


def propose(path: Path, said: Answers, volume_L: Mapping[str, float] | None = None) -> Proposal:
    """Read a file and guess what `said` leaves open.

    Args:
        path: the file.
        said: answers so far; they are not changed.
        volume_L: volumes by vessel, `cv` or `reservoir`; an empty name means the vessel that was measured.

    Raises CaseError if the file cannot be read, or has no pressure.
    """
    table = read_foreign(path, said.text)
    columns = guess_columns(table, said.columns)
    answers = Answers(table.layout, msgspec.structs.replace(said.setup), {**said.rig}, columns)
    meanings = [column.meaning for column in columns if column.meaning != IGNORED]
    for meaning in meanings:
        if meanings.count(meaning) > 1:
            raise CaseError(f"{path}: two columns are {meaning}; write {IGNORED} for one of them")
    if not set(PRESSURES) & set(meanings):
        raise CaseError(
            f"{path}: no column looks like a pressure; name the column: --column N=cv_pressure:kPa"
            f"{_read_as(columns)}"
        )
    notes = list(table.remarks)
    questions = []
    for c in columns:
        if c.unit and parse_unit(c.unit).quantity == "raw" and QUANTITIES.get(c.meaning) == "pressure":
            points = f"{c.unit} (0.5=0, 4.5=1000)"
            text = f"two points of its calibration, as {points}: readings and kPa gauge"
            option = f"--column {c.number}={c.meaning}:'{points}'"
            questions.append(ImportQuestion(f"columns.{c.number}.unit", text, option))
    if "time" not in meanings and said.setup.sample_Hz is None:
        text = "there is no time column: how many rows were recorded in a second?"
        questions.append(ImportQuestion("setup.sample_Hz", text, "--column N=time:s"))
    runs = {} if questions else dict(_runs(table, answers, notes))
    if runs:
        questions += _doubtful_units(answers, said, runs)
        runs = _with_valves(path, answers, runs, notes)
        measured = "cv" if "cv_pressure" in next(iter(runs.values())) else "reservoir"
        for vessel, litres in (volume_L or {}).items():
            table_of = answers.rig.get(vessel or measured, {})
            answers.rig[vessel or measured] = {**table_of, "volume_L": litres}
        questions += [*_missing_volumes(answers, runs), *_guessed_setup(said, answers)]
    return Proposal(path, table, answers, tuple(questions), tuple(notes), runs)


def _read_as(columns: Sequence[ImportedColumn]) -> str:
    """Which column is read as what, as the end of an error."""
    texts = [f"{c.number} {c.name}".strip() + f" ({c.meaning})" for c in columns]
    return "; the columns: " + ", ".join(texts[:12]) + (", …" if len(texts) > 12 else "")


def answers_of_similar(path: Path, before: Proposal) -> Answers:
    """The answers of another file for this one, if its columns have the same names; else none."""
    table = read_foreign(path)
    if table.names != before.table.names:
        return Answers()
    answers = msgspec.convert(msgspec.to_builtins(before.answers), Answers)
    answers.text = None
    answers.setup.outlet = None
    return answers


def is_foreign(path: Path) -> bool:
    """True for a file that is not in the format of a case, or was imported before."""
    if not path.is_file() or path.suffix.casefold() == ".toml":
        return False
    try:
        return answers_path(path).exists() or not has_header(path)
    except OSError:
        return False


def read_imported(path: Path, rig: Path | str | None = None) -> Case:
    """The case in a file of any layout, by its answers file. CaseError if an answer is missing."""
    answers = answers_path(path)
    proposal = propose(path, read_answers(answers))
    if proposal.missing:
        raise CaseError(missing_line(path, proposal.missing[0]._replace(option=f"import {path}"), answers))
    with TemporaryDirectory() as folder:
        write_case([proposal], Path(folder))
        try:
            case = read_case(folder, rig)
        except CaseError as error:
            raise CaseError(str(error).replace(folder, str(path))) from None
    return replace(case, path=path, remarks=(*proposal.notes, *case.remarks))


def write_case(proposals: Sequence[Proposal], folder: Path) -> list[Path]:
    """Write rig.toml and one CSV for each run. Returns the paths of the CSVs.

    Raises CaseError if the files disagree about the rig, or the folder has other runs.
    """
    rigs = [rig_tables(proposal.answers, list(proposal.runs.values())) for proposal in proposals]
    for proposal, rig in zip(proposals, rigs, strict=True):
        for vessel in ("cv", "reservoir", "gas"):
            if rig.get(vessel) != rigs[0].get(vessel):
                raise CaseError(
                    f"{proposal.path}: its {vessel} is not that of {proposals[0].path}; import it alone"
                )
    texts = {f"{name}.csv": _csv(run) for p in proposals for name, run in p.runs.items()}
    if len(texts) < sum(len(p.runs) for p in proposals):
        raise CaseError(f"{folder}: two runs have the same name; rename one of the files")
    folder.mkdir(parents=True, exist_ok=True)
    if other := sorted(p.name for p in folder.glob("*.csv") if p.name not in texts):
        raise CaseError(f"{folder}: contains {other[0]}, which is not from this import; use another --to")
    lines = ["# Written by flying-vines import from the answers in *.import.toml."]
    for name, numbers in rigs[0].items():
        as_floats = {key: v if isinstance(v, str) else float(v) for key, v in numbers.items()}
        lines += ["", *table_lines(name, as_floats)]
    (folder / RIG).write_text("\n".join([*lines, ""]), encoding="utf-8")
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in texts]


def _runs(table: ForeignTable, answers: Answers, notes: list[str]) -> Iterator[tuple[str, Run]]:
    """The runs of a file: they end where the run column changes or the time jumps back."""
    values = _converted(table, answers)
    length = len(table.cells[0])
    number = values.pop("run", np.zeros(length))
    if answers.setup.sample_Hz and "time" not in values:
        values["time"] = np.arange(length) / answers.setup.sample_Hz
    order = np.flatnonzero(np.isfinite(values["time"]))
    time_s, number = values["time"][order], number[order]
    steps = np.diff(time_s)
    usual_s = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
    again = (steps < -10.0 * usual_s) | (np.diff(np.nan_to_num(number, nan=-1.0)) != 0.0)
    edges = [0, *(np.flatnonzero(again) + 1).tolist(), len(order)]
    parts = [order[first:last] for first, last in pairwise(edges)]
    kept = [part for part in parts if _long_enough(values["time"][part])]
    if dropped := len(parts) - len(kept):
        notes.append(f"left out {counted(dropped, 'run')} with less than {MIN_SAMPLES} rows or {MIN_S:g} s")
    if not kept:
        raise CaseError(f"{table.path}: its {length} rows are too few or too short in time for a run")
    for count, rows in enumerate(kept, start=1):
        run = {meaning: column[rows] for meaning, column in values.items()}
        run["time"] = _in_order(run, notes)
        for meaning in PRESSURES:
            if meaning in run:
                run[meaning] = _without_spikes(run[meaning], meaning, notes)
        yield (table.path.stem if len(kept) == 1 else f"{table.path.stem}_{count}"), run


def _converted(table: ForeignTable, answers: Answers) -> Run:
    """The columns of a file in the units of a case, by meaning."""
    values: Run = {}
    for column in answers.columns:
        if column.meaning != IGNORED:
            raw = table.numbers(column.number - 1)
            unit = parse_unit(column.unit) if column.unit else None
            values[column.meaning] = raw if unit is None else raw * unit.factor + unit.offset
    return values


def _without_spikes(pressure_kPa: Array, meaning: str, notes: list[str]) -> Array:
    """The readings, with NaN where the sensor was disturbed."""
    spikes, below = is_spike(pressure_kPa), pressure_kPa < -_VACUUM_KPA
    spikes |= below & (below.mean() < 0.01)
    if spikes.any():
        found = counted(int(np.sum(spikes)), "spike")
        notes.append(f"{found} of {meaning} left out: the sensor was disturbed")
    return np.where(spikes, np.nan, pressure_kPa)


def _long_enough(time_s: Array) -> bool:
    return len(time_s) >= MIN_SAMPLES and float(np.ptp(time_s)) >= MIN_S


def _in_order(run: Run, notes: list[str]) -> Array:
    """Time in rising order; rows that share a time stamp (a clock without fractions) are spread evenly."""
    order = np.argsort(run["time"], kind="stable")
    if (order != np.arange(len(order))).any():
        notes.append("some rows were not in order of time; sorted")
        run.update({meaning: column[order] for meaning, column in run.items()})
    time_s = run["time"] - (run["time"][0] if run["time"][0] > _EPOCH_S else 0.0)
    stamps, first = np.unique(time_s, return_index=True)
    if len(time_s) - len(stamps) > 0.2 * len(time_s) and len(stamps) > 2:
        notes.append("several rows have the same time stamp; they are spread evenly until the next one")
        end = len(time_s), stamps[-1] + float(np.median(np.diff(stamps)))
        time_s = np.interp(np.arange(len(time_s)), [*first, end[0]], [*stamps, end[1]])
    return time_s


def _doubtful_units(answers: Answers, said: Answers, runs: Mapping[str, Run]) -> Iterator[ImportQuestion]:
    """Questions for pressures with kPa in the heading that behave like psi, unless the user gave a unit."""
    sure = {column.number for column in said.columns if column.unit}
    for column in answers.columns:
        if column.meaning not in PRESSURES or column.number in sure or column.unit != "kPa":
            continue
        reasons = [psi_instead(run["time"], run[column.meaning]) for run in runs.values()]
        if all(reasons):
            column.unit = ""
            text = f"psi or kPa? Its heading says kPa, but {reasons[0]}"
            yield ImportQuestion(
                f"columns.{column.number}.unit", text, f"--column {column.number}={column.meaning}:psi"
            )


def _with_valves(path: Path, answers: Answers, runs: dict[str, Run], notes: list[str]) -> dict[str, Run]:
    """The runs with the valve columns that the case format needs; guesses the outlet and the source."""
    setup, name = answers.setup, path.name
    has = set(next(iter(runs.values())))
    if "cv_pressure" in has and not has & {"reservoir_pressure", "evp_opening"}:
        if any(_rises(run["cv_pressure"]) for run in runs.values()):
            raise CaseError(
                f"{path}: the chamber is filled, but no column looks like its pump or valve; name it: "
                f"--column N=evp_opening{_read_as(answers.columns)}"
            )
        notes.append(
            f"{name}: a chamber alone is written as a reservoir; the rig file has no other vessel for it"
        )
        for column in answers.columns:
            column.meaning = "reservoir_pressure" if column.meaning == "cv_pressure" else column.meaning
        runs = {k: _renamed(run, "cv_pressure", "reservoir_pressure") for k, run in runs.items()}
        has = set(next(iter(runs.values())))
    if has & set(_VALVES) and "cv_pressure" not in has:
        if "evp_opening" not in has and "solenoid" in has:
            notes.append(f"{name}: the outlet of the vessel is written as evp_opening")
            return {k: _renamed(run, "solenoid", "evp_opening") for k, run in runs.items()}
        return runs
    if has & set(_VALVES):
        if "reservoir_pressure" not in has:
            setup.source = setup.source or "pump"
        if setup.source == "pump":
            notes.append(
                f"{name}: free flow and stall pressure of the pump are estimated from how the pressure rises"
            )
        return runs
    if "reservoir_pressure" in has and "cv_pressure" in has:
        raise CaseError(
            f"{path}: no column is the inflation valve; name it: --column N=evp_opening, or leave out "
            f"one of the pressures: --column N={IGNORED}{_read_as(answers.columns)}"
        )
    return {run_name: _alone(run, answers, notes, run_name) for run_name, run in runs.items()}


def _renamed(run: Run, meaning: str, new: str) -> Run:
    return {new if name == meaning else name: values for name, values in run.items()}


def _rises(pressure_kPa: Array) -> bool:
    p = from_ambient(pressure_kPa[np.isfinite(pressure_kPa)])
    gain_kPa = float(np.median(np.sort(p)[-5:]) - np.median(p[:5])) if len(p) else 0.0
    return gain_kPa > 1.0 + 0.15 * float(np.ptp(p))


def _alone(run: Run, answers: Answers, notes: list[str], name: str) -> Run:
    """A vessel of which only the pressure was recorded, with the opening of its outlet."""
    filled_s = _filled_time(run["time"], run["reservoir_pressure"])
    if filled_s is not None:
        notes.append(f"{name}: the vessel is filled until {filled_s:.6g} s; these rows are left out")
        run = _from(run, filled_s)
    opens_s = _opening_time(run["time"], run["reservoir_pressure"], late=True)
    if answers.setup.outlet is None:
        answers.setup.outlet = "shut" if _only_leaks(run, opens_s) else "opens"
    outlet = answers.setup.outlet
    if outlet == "open":
        return run
    if outlet == "shut":
        held_s = _opening_time(run["time"], run["reservoir_pressure"], late=False)
        if held_s is not None:
            notes.append(
                f"{name}: the pressure is held by a supply until {held_s:.6g} s; these rows are left out"
            )
            run = _from(run, held_s)
        return _with_outlet(run, inf)
    if outlet != "opens":
        opens_s = float(outlet)
    elif opens_s is None:
        opens_s = float(run["time"][0])
    if opens_s <= run["time"][-1]:
        notes.append(f"{name}: the outlet (written as evp_opening) opens at {opens_s:.6g} s")
    return _with_outlet(run, opens_s)


def _from(run: Run, start_s: float) -> Run:
    """The rows of a run from a time on."""
    return {meaning: column[run["time"] >= start_s] for meaning, column in run.items()}


def _only_leaks(run: Run, opens_s: float | None) -> bool:
    """True if the pressure falls too slowly for an outlet that opens at this time."""
    open_after = np.where(run["time"] >= (opens_s or 0.0), 1.0, 0.0)
    time_constant_s = fall_s(run["time"], run["reservoir_pressure"], open_after)
    return opens_s is None or time_constant_s is None or time_constant_s > _MAX_VALVE_S


def _with_outlet(run: Run, opens_s: float) -> Run:
    """The run of a vessel with the valve columns: its outlet, written as evp_opening, opens at this time."""
    opening = (run["time"] >= opens_s).astype(float)
    shut = np.zeros_like(opening)
    # The valve moved at an unknown time between two readings: the second does not follow from the first.
    after_gap = np.concatenate(([0.0, 0.0], np.diff(opening)[:-1]))
    return {**run, "evp_opening": opening, "dvp_opening": shut, "solenoid": shut, "after_gap": after_gap}


def _filled_time(time_s: Array, pressure_kPa: Array) -> float | None:
    """Time of the highest pressure, if the vessel is filled in this run; else None.

    It is filled if the first pressure is below half of the highest.
    """
    there = np.isfinite(pressure_kPa)
    t, p = time_s[there], from_ambient(pressure_kPa[there])
    if len(p) < MIN_SAMPLES:
        return None
    top = int(np.argmax(p))
    return float(t[top]) if p[0] < 0.5 * p[top] and _long_enough(t[top:]) else None


def _opening_time(time_s: Array, pressure_kPa: Array, *, late: bool) -> float | None:
    """When a held pressure begins to fall; None if it never does, or falls from its first reading.

    With `late`, a smaller first step also belongs to the fall: the outlet opened shortly before a reading.
    """
    there = np.isfinite(pressure_kPa)
    t, p = time_s[there], from_ambient(pressure_kPa[there])
    if len(p) < MIN_SAMPLES or float(p[0] - np.min(p)) < 0.5 * abs(float(p[0])):
        return None
    rates = np.diff(p) / np.maximum(np.diff(t), 1e-9)
    steepest = float(np.min(rates))
    first = int(np.argmax(rates < 0.4 * steepest))
    held = float(np.median(rates[:first])) if first else 0.0
    while late and first > 3 and rates[first - 1] < held + 0.1 * (steepest - held):
        first -= 1
    return float(t[first]) if first >= 3 and np.median(rates[:first]) > 0.1 * steepest else None


def _missing_volumes(answers: Answers, runs: Mapping[str, Run]) -> Iterator[ImportQuestion]:
    measured = set(next(iter(runs.values())))
    needed = {vessel for pressure, vessel in PRESSURES.items() if pressure in measured}
    if answers.setup.source == "reservoir":
        needed.add("reservoir")
    for vessel in sorted(needed):
        if "volume_L" not in answers.rig.get(vessel, {}):
            what = {"cv": "chamber that is inflated", "reservoir": "vessel that supplies the air"}[vessel]
            if "cv_pressure" not in measured:
                what = "vessel"
            yield ImportQuestion(
                f"rig.{vessel}.volume_L", f"the volume of the {what} in litres", f"--volume-L {vessel}=L"
            )


def _guessed_setup(said: Answers, answers: Answers) -> Iterator[ImportQuestion]:
    """Questions about outlet and source, with the guesses."""
    if said.setup.outlet is None and answers.setup.outlet is not None:
        text = (
            "what the outlet does: shut (the vessel leaks), open, opens (when the pressure begins to fall), "
            "or the time in s at which it opens"
        )
        yield ImportQuestion("setup.outlet", text, "", str(answers.setup.outlet))
    if said.setup.source is None and answers.setup.source is not None:
        text = (
            "what fills the chamber: pump (or a supply of constant pressure behind a valve), or reservoir "
            "(a vessel behind a valve)"
        )
        yield ImportQuestion("setup.source", text, "", answers.setup.source)


def _csv(run: Run) -> str:
    # A constant ambient pressure excludes the cause `ambient_drop`: a laboratory stays at one altitude.
    run = {"ambient_pressure": np.full(len(run["time"]), STANDARD_PRESSURE_KPA), **run}
    names = [meaning for meaning in _CASE_COLUMNS if meaning in run]
    cells = [[_cell(meaning, value) for value in run[meaning].tolist()] for meaning in names]
    head = ",".join(_CASE_COLUMNS[name] for name in names)
    return "\n".join([head, *map(",".join, zip(*cells, strict=True)), ""])


def _cell(meaning: str, value: float) -> str:
    if value != value:
        return ""
    if meaning in ("solenoid", "after_gap"):
        return str(int(value >= 0.5))
    return f"{value:.6f}" if meaning == "time" else f"{value:.7g}"


def show(proposal: Proposal, console: Console) -> None:
    """Print how a file is read: layout, columns, runs, and notes."""
    text, table = proposal.table.layout, Table(box=None, pad_edge=False, header_style="bold")
    header = f"header in line {text.header_line}" if text.header_line else "no header"
    rows = len(proposal.table.cells[0])
    console.print(f"{proposal.path.name}  {rows} rows, {_SEPARATORS[text.separator]}, "
                  f"decimal “{text.decimal}”, {text.encoding}, {header}", highlight=False)  # fmt: skip
    for title in ("column", "meaning", "unit", "factor", "first values, converted", "why"):
        table.add_column(title, overflow="fold", no_wrap=title == "meaning")
    for column in proposal.answers.columns:
        unit = parse_unit(column.unit) if column.unit else None
        values = proposal.table.numbers(column.number - 1)[:3]
        if unit:
            values = values * unit.factor + unit.offset
        first = ", ".join(f"{value:.5g}" for value in values.tolist())
        factor = f"{unit.factor:.5g}" + (f" {unit.offset:+.6g}" if unit.offset else "") if unit else ""
        name = f"{column.number} {column.name}"
        style = "dim" if column.meaning == IGNORED else ""
        table.add_row(name, column.meaning, column.unit, factor, first, column.why, style=style)
    console.print(table, highlight=False, markup=False)
    for name, run in proposal.runs.items():
        console.print(f"Run   {name}: {len(run['time'])} rows, {np.ptp(run['time']):.4g} s", highlight=False)
    for note in proposal.notes:
        console.print(f"Note  {note}", highlight=False, markup=False)
    for question in proposal.questions:
        if question.guess:
            console.print(
                f"Guess {question.key} = {question.guess}: {question.text}", highlight=False, markup=False
            )


def draw(proposal: Proposal, folder: Path) -> Path:
    """Draw pressures and valve signals of all runs, converted. Returns the path. Needs matplotlib."""
    from matplotlib import pyplot as plt

    from flying_vines.plots.style import BLUE, GREEN, GREY, ORANGE, PURPLE, finish, save

    figure, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained", height_ratios=(2, 1))
    kinds = (
        (0, {"reservoir_pressure": ORANGE, "cv_pressure": BLUE, "command_kPa": GREY}, "kPa gauge"),
        (1, {"evp_opening": BLUE, "dvp_opening": PURPLE, "solenoid": GREEN}, "opening, 0…1"),
    )
    for row, colours, unit in kinds:
        axes[row].set_ylabel(unit)
        style = "steps-post" if row else "default"  # a command holds until the next one
        for run in proposal.runs.values():
            for meaning, colour in colours.items():
                if meaning in run and (row == 0 or np.any(run[meaning])):
                    axes[row].plot(
                        run["time"],
                        run[meaning],
                        color=colour,
                        lw=1,
                        label=meaning.removesuffix("_kPa"),
                        drawstyle=style,
                    )
        handles = dict(zip(*reversed(axes[row].get_legend_handles_labels()), strict=True))
        if handles:
            axes[row].legend(handles.values(), handles.keys(), fontsize=8)
        elif row:
            axes[row].set_title("no valve ever opens", fontsize=9, loc="left")
    axes[1].set_ylim(-0.05, 1.05)
    axes[1].set_xlabel("time, s")
    finish(figure, f"{proposal.path.name} as it is imported")
    return save({"import": figure}, folder, proposal.path.stem)[0]
