"""`flying-vines import`: recordings of any layout as a case for `diagnose`."""

from __future__ import annotations

import argparse
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flying_vines.cli.common import fail, file_errors, needs_analysis

if TYPE_CHECKING:
    from flying_vines.identification.importing.columns import ImportedColumn
    from flying_vines.identification.importing.runs import Proposal


def add(commands: Any) -> None:
    """Add `import` to the parsers of the command line."""
    command = commands.add_parser("import", help="recordings of any layout as a case for diagnose")
    command.add_argument("files", type=Path, nargs="+", metavar="FILE", help="a text file of numbers")
    command.add_argument("--to", type=Path, metavar="FOLDER", help="the case folder (default: NAME-case)")
    command.add_argument(
        "--column",
        action="append",
        default=[],
        metavar="N=MEANING[:UNIT]",
        help="what column N is, as 3=cv_pressure:psi; may be given again",
    )
    command.add_argument(
        "--volume-L",
        action="append",
        default=[],
        dest="volume_L",
        metavar="[VESSEL=]L",
        help="volume of the measured vessel, or of cv= or reservoir=; may be given again",
    )
    command.set_defaults(run=_import)


def _import(arguments: argparse.Namespace) -> int:
    with needs_analysis():
        from flying_vines.identification.case import read_case
        from flying_vines.identification.importing.runs import write_case
        from flying_vines.identification.recording import CaseError
    files: list[Path] = arguments.files
    folder: Path = arguments.to or files[0].with_name(f"{files[0].stem}-case")
    with file_errors(folder, CaseError):
        columns, volumes = [_column(said) for said in arguments.column], _volumes(arguments.volume_L)
        proposals: list[Proposal] = []
        for path in files:
            proposals.append(_proposal(path, proposals[-1] if proposals else None, columns, volumes, folder))
        runs = write_case(proposals, folder)
        for proposal in proposals:
            _draw(proposal, folder)
        for run in runs:
            print(f"Run      {run}")
        try:
            read_case(folder)
        except CaseError as error:
            fail(f"the case is written, but diagnose refuses it: {error}")
    print(f"Next     flying-vines diagnose {folder}")
    return 0


def _proposal(
    path: Path,
    before: Proposal | None,
    columns: list[ImportedColumn],
    volumes: dict[str, float],
    folder: Path,
) -> Proposal:
    """How a file is imported: by its kept answers, the options, and what a person says on the terminal."""
    from rich.console import Console

    from flying_vines.identification.importing.answers import (
        answers_path,
        missing_line,
        read_answers,
        same_answers,
        with_answer,
        with_column,
    )
    from flying_vines.identification.importing.runs import answers_of_similar, propose
    from flying_vines.identification.importing.show import show
    from flying_vines.identification.recording import CaseError

    kept = answers_path(path)
    if not kept.exists() and (folder / kept.name).exists():
        kept = folder / kept.name
    said = read_answers(kept)
    if before and not kept.exists():
        said = answers_of_similar(path, before)
    for column in columns:
        with_column(said, column)
    proposal = propose(path, said, volumes)
    show(proposal, Console())
    while proposal.questions and sys.stdin.isatty():
        said = proposal.answers
        for question in proposal.questions:
            while True:
                try:
                    given = input(
                        f"{path.name}: {question.text}{question.guess and f' [{question.guess}]'}: "
                    )
                    with_answer(said, question.key, given.strip() or question.guess)
                    break
                except CaseError as error:
                    print(error)
                except EOFError:
                    fail(missing_line(path, question, kept))
        proposal = propose(path, said)
        show(proposal, Console())
    if not kept.exists() or not same_answers(proposal.answers, read_answers(kept)):
        kept = _keep(proposal, kept, folder)
    if proposal.missing:
        fail(missing_line(path, proposal.missing[0], kept))
    print(f"Answers  {kept}")
    return proposal


def _keep(proposal: Proposal, path: Path, folder: Path) -> Path:
    """Write the answers beside the data, or into the case folder if that is not possible: where they are."""
    from flying_vines.identification.importing.answers import write_answers

    try:
        write_answers(path, proposal.answers, proposal.questions)
    except OSError:
        path = folder / path.name
        write_answers(path, proposal.answers, proposal.questions)
    return path


def _draw(proposal: Proposal, folder: Path) -> None:
    if find_spec("matplotlib") is None:
        return
    from flying_vines.identification.importing.show import draw

    try:
        path = draw(proposal, proposal.path.parent)
    except OSError:
        path = draw(proposal, folder)
    print(f"Picture  {path}")


def _column(said: str) -> ImportedColumn:
    """The column in `3=cv_pressure:psi`."""
    from flying_vines.identification.importing.answers import check_column
    from flying_vines.identification.importing.columns import ImportedColumn

    number, _, rest = said.partition("=")
    meaning, _, unit = rest.partition(":")
    if not number.isdecimal() or not meaning:
        fail(f"--column {said}: write the number of the column, its meaning and unit, as 3=cv_pressure:psi")
    column = ImportedColumn(int(number), meaning.strip(), unit.strip())
    check_column(column)
    return column


def _volumes(said: list[str]) -> dict[str, float]:
    """Litres by vessel, in `0.5`, `cv=0.5` or `reservoir=2`."""
    from flying_vines.identification.importing.answers import volume_L

    volumes = {}
    for text in said:
        vessel, _, litres = text.rpartition("=")
        if vessel not in ("", "cv", "reservoir"):
            fail(f"--volume-L {text}: there is no vessel {vessel!r}; it is cv or reservoir")
        volumes[vessel] = volume_L(litres)
    return volumes
