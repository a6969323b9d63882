"""The answers file `NAME.import.toml` beside a recording: how to read it, and facts about the rig.

It contains all guesses and answers. Edited values are used unchanged. Missing values are guessed, or the user
is asked for them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec

from flying_vines.config.on_disk import put
from flying_vines.config.toml_edit import table_lines
from flying_vines.files.toml_text import converted, one_line, read_text
from flying_vines.identification.importing.columns import MEANINGS, ImportedColumn
from flying_vines.identification.importing.layout import TextLayout
from flying_vines.identification.importing.units import parse_unit
from flying_vines.identification.recording import CaseError
from flying_vines.physics.rig import RigError, rig_from

ENDING = ".import.toml"


class ImportSetup(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """How the rig was driven. None: guess or ask."""

    outlet: Literal["shut", "open", "opens"] | float | None = None
    """Outlet of a vessel that was recorded alone: `shut` (the vessel leaks), `open` (from the start), `opens`
    (when the pressure begins to fall), or the time in s at which it opens."""
    source: Literal["pump", "reservoir"] | None = None
    """What fills the chamber, if no reservoir pressure was recorded."""
    sample_Hz: Annotated[float, msgspec.Meta(ge=1e-4, le=1e6)] | None = None
    """Sample rate of a file without a time column."""
    gas: str | None = None
    """Name of the gas, as in a rig.toml; default: air."""


class Answers(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """The content of an answers file."""

    text: TextLayout | None = None
    setup: ImportSetup = msgspec.field(default_factory=ImportSetup)
    rig: dict[str, Any] = msgspec.field(default_factory=dict)
    """The known tables of a rig.toml."""
    columns: list[ImportedColumn] = msgspec.field(default_factory=list)


class ImportQuestion(NamedTuple):
    """A value that the file does not contain: key of the answer, question, and command-line option."""

    key: str
    text: str
    option: str
    guess: str = ""
    """Used if nobody answers; empty if the answer is necessary."""


def missing_line(recording: Path, question: ImportQuestion, answers: Path) -> str:
    """What is missing, and where to write it, on one line."""
    where = f"write {question.key} in {answers}, or give {question.option}"
    return one_line(f"{recording}: missing: {question.text}; {where}")


def answers_path(recording: Path) -> Path:
    return recording.with_name(recording.stem + ENDING)


def same_answers(one: Answers, other: Answers) -> bool:
    """True if two sets of answers are equal except for the reasons of the guesses."""
    a, b = msgspec.to_builtins((one, other))
    for column in [*a.get("columns", ()), *b.get("columns", ())]:
        column["why"] = ""
    return bool(a == b)


def read_answers(path: Path) -> Answers:
    """The answers in a file; empty if there is no such file. CaseError if the file is wrong."""
    if not path.exists():
        return Answers()
    text = read_text(path, CaseError)
    answers: Answers = converted(text, str(path), Answers, CaseError)
    try:
        for column in answers.columns:
            check_column(column)
        rig_from(answers.rig)
        if answers.setup.gas:
            rig_from({"gas": {"name": answers.setup.gas}})
    except (CaseError, RigError) as error:
        raise CaseError(f"{path}: {error}") from None
    return answers


def check_column(column: ImportedColumn) -> None:
    """CaseError if there is no such meaning or unit. The unit gets its usual spelling."""
    if column.meaning and column.meaning not in MEANINGS:
        raise CaseError(f"{column.meaning!r} is not a meaning of a column; use one of {', '.join(MEANINGS)}")
    if column.unit:
        column.unit = parse_unit(column.unit).name


def column_from_option(text: str) -> ImportedColumn:
    """The column in `3=cv_pressure:psi`."""
    number, _, rest = text.partition("=")
    meaning, _, unit = rest.partition(":")
    if not number.isdecimal() or not meaning:
        raise CaseError(f"column {text!r}: write its number, meaning and unit, as 3=cv_pressure:psi")
    return ImportedColumn(int(number), meaning.strip(), unit.strip())


def volume_from_option(text: str) -> tuple[str, float]:
    """The vessel and the litres in `cv=0.5`, or in `0.5` without a vessel."""
    vessel, _, litres = text.rpartition("=")
    if vessel not in ("", "cv", "reservoir"):
        raise CaseError(f"volume {text!r}: there is no vessel {vessel!r}; use cv or reservoir")
    return vessel, volume_L(litres)


def set_column(answers: Answers, column: ImportedColumn) -> None:
    """Replace or add one column in the answers."""
    check_column(column)
    answers.columns = [kept for kept in answers.columns if kept.number != column.number] + [column]


def set_answer(answers: Answers, key: str, said: str) -> None:
    """Set the answer to a question, as a person wrote it. CaseError if it cannot be used."""
    first, _, last = key.partition(".")
    if first == "columns":
        (column,) = (c for c in answers.columns if c.number == int(last.partition(".")[0]))
        set_column(answers, msgspec.structs.replace(column, unit=parse_unit(said).name))
    elif first == "rig":
        vessel = last.partition(".")[0]
        answers.rig.setdefault(vessel, {})["volume_L"] = volume_L(said)
    else:
        value: object = said.strip()
        if last == "sample_Hz" or re.fullmatch(r"\d*\.?\d+", said.strip()):
            value = _number(said)
        try:
            answers.setup = msgspec.convert(
                {**msgspec.structs.asdict(answers.setup), last: value}, ImportSetup
            )
        except msgspec.ValidationError as error:
            raise CaseError(f"{last}: {said!r} cannot be used: {error}") from None


def volume_L(said: str) -> float:
    """Litres of `0.5`, `0.5 L` or `30 cm3`."""
    number, _, unit = re.sub(r"([\d.])\s*([a-zA-Z])", r"\1 \2", said.strip(), count=1).partition(" ")
    unit_found = parse_unit(unit or "L")
    if unit_found.quantity != "volume":
        raise CaseError(f"{said!r} is not a volume; write litres, as 0.5")
    return _number(number) * unit_found.factor


def _number(said: str) -> float:
    try:
        value = float(said)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise CaseError(f"{said!r} is not a positive number")
    return value


def write_answers(path: Path, answers: Answers, missing: Sequence[ImportQuestion]) -> None:
    """Write the answers file; missing answers are comments in it. OSError if that fails."""
    name = one_line(path.name.removesuffix(ENDING))
    lines = [f"# How `flying-vines import` reads {name}. Edit what is wrong, and import again."]
    lines += [
        f"# Missing: {question.key}: {one_line(question.text)}" for question in missing if not question.guess
    ]
    if answers.text:
        lines += _table("text", msgspec.structs.asdict(answers.text))
    lines += _table("setup", msgspec.structs.asdict(answers.setup))
    for name, table in answers.rig.items():
        lines += _table(f"rig.{name}", table if isinstance(table, Mapping) else {})
    for column in sorted(answers.columns, key=lambda column: column.number):
        lines += ["", *([f"# {one_line(column.why)}"] if column.why else [])]
        lines += _table("[columns]", {**msgspec.structs.asdict(column), "why": None})[1:]
    put(path, "\n".join([*lines, ""]))


def _table(name: str, values: Mapping[str, Any]) -> list[str]:
    """A table as lines, without values that are None or empty."""
    given = {key: value for key, value in values.items() if value not in (None, "")}
    return ["", *table_lines(name, given)] if given else []
