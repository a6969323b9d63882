"""`flying-vines import`: recordings of any layout as a case for `diagnose`."""

from __future__ import annotations

import argparse
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flying_vines.cli.common import fail, file_errors, needs_analysis

if TYPE_CHECKING:
    from flying_vines.identification.importing.answers_file import Answers, ImportQuestion
    from flying_vines.identification.importing.runs import Proposal


def add(commands: Any) -> None:
    """Add `import` to the parsers of the command line."""
    command = commands.add_parser("import", help="make a case for diagnose from recordings of any layout")
    command.add_argument("files", type=Path, nargs="+", metavar="FILE", help="a text file of numbers")
    command.add_argument("--to", type=Path, metavar="FOLDER", help="the case folder (default: NAME-case)")
    again = {"action": "append", "default": []}
    what = "meaning of column N, e.g. 3=cv_pressure:psi; may be repeated"
    command.add_argument("--column", metavar="N=MEANING[:UNIT]", help=what, **again)
    what = "litres of the measured vessel, or of a named one (cv=, reservoir=); may be repeated"
    command.add_argument("--volume-L", metavar="[VESSEL=]L", help=what, **again)
    command.set_defaults(run=_import)


def _import(arguments: argparse.Namespace) -> int:
    with needs_analysis():
        from flying_vines.identification.case import CaseError, read_case
        from flying_vines.identification.importing.runs import write_case
    files: list[Path] = arguments.files
    folder: Path = arguments.to or files[0].with_name(f"{files[0].stem}-case")
    with file_errors(folder, CaseError):
        proposals: list[Proposal] = []
        for path in files:
            proposals.append(_proposal(path, proposals[0] if proposals else None, arguments, folder))
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


def _proposal(path: Path, first: Proposal | None, options: argparse.Namespace, folder: Path) -> Proposal:
    """Decide how a file is imported: from saved answers, options, and the user's answers on the terminal."""
    from rich.console import Console

    from flying_vines.identification.importing import answers_file
    from flying_vines.identification.importing.runs import answers_of_similar, propose, show

    saved = answers_file.answers_path(path)
    if not saved.exists() and (folder / saved.name).exists():
        saved = folder / saved.name
    said = (
        answers_of_similar(path, first) if first and not saved.exists() else answers_file.read_answers(saved)
    )
    for text in options.column:
        answers_file.set_column(said, answers_file.column_from_option(text))
    proposal = propose(path, said, dict(answers_file.volume_from_option(text) for text in options.volume_L))
    show(proposal, Console(markup=False))
    while proposal.questions and sys.stdin.isatty():
        for question in proposal.questions:
            _ask(path, question, proposal.answers)
        proposal = propose(path, proposal.answers)
        show(proposal, Console(markup=False))
    if not saved.exists() or not answers_file.same_answers(
        proposal.answers, answers_file.read_answers(saved)
    ):
        try:
            answers_file.write_answers(saved, proposal.answers, proposal.missing)
        except OSError:
            saved = folder / saved.name
            answers_file.write_answers(saved, proposal.answers, proposal.missing)
    if proposal.missing:
        fail(answers_file.missing_line(path, proposal.missing[0], saved))
    print(f"Answers  {saved}")
    return proposal


def _ask(path: Path, question: ImportQuestion, answers: Answers) -> None:
    """Ask until the answer can be used."""
    from flying_vines.identification.importing.answers_file import set_answer
    from flying_vines.identification.recording import CaseError

    guess = f" [{question.guess}]" if question.guess else ""
    while True:
        try:
            said = input(f"{path.name}: {question.text}{guess}: ").strip()
            return set_answer(answers, question.key, said or question.guess)
        except EOFError:
            fail(f"{path}: no answer to: {question.text}")
        except CaseError as error:
            print(error)


def _draw(proposal: Proposal, folder: Path) -> None:
    """Draw the runs into the folder of the data, or into the case folder if that is not possible."""
    if find_spec("matplotlib") is None:
        return
    from flying_vines.identification.importing.runs import draw

    try:
        path = draw(proposal, proposal.path.parent)
    except OSError:
        path = draw(proposal, folder)
    print(f"Picture  {path}")
