"""`flying-vines diagnose`: finds why a recorded rig differs from the simulation."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flying_vines.cli.common import (
    BAD_INPUT,
    add_option,
    fail,
    file_errors,
    needs_analysis,
    progress_bar,
    show_found,
)

if TYPE_CHECKING:
    from rich.console import Console


_PLAN_OPTIONS = ("minutes", "air_SL")
_SINGLE_OPTIONS = ("from_log", "write_rig", "out", "cause")
_NOT_FOR_PLANS = ("from_log", "rig", "scheduler", "write_rig")


def add(commands: Any) -> None:
    """Add `diagnose` to the parsers of the command line."""
    diagnose = commands.add_parser("diagnose", help="find why a recorded rig differs from the simulation")
    diagnose.add_argument(
        "case",
        type=Path,
        nargs="*",
        metavar="CASE",
        help="a folder with rig.toml and runs; one run; or one flight",
    )
    diagnose.add_argument(
        "--from-log", type=Path, metavar="LOG", help="a flight log, its folder, or flights/last"
    )
    add_option(diagnose, "--rig", help="the nominal rig (default: the case's own)")
    diagnose.add_argument(
        "--scheduler", metavar="ADDRESS", help="a Dask scheduler: its workers do the diagnosis"
    )
    diagnose.add_argument("--write-rig", type=Path, metavar="FILE", help="write the rig with its causes")
    diagnose.add_argument("--plan", action="store_true", help="CASE is a rig.toml: plan which runs to record")
    diagnose.add_argument("--minutes", type=float, metavar="M", help="with --plan: recording time (3)")
    diagnose.add_argument(
        "--air-SL", type=float, metavar="N", help="with --plan: air, standard litres (one full reservoir)"
    )
    add_option(diagnose, "--out", help="write the report or the plan there")
    add_option(diagnose, "--json")
    add_option(diagnose, "--cause")
    diagnose.set_defaults(run=_diagnose)


def _diagnose(arguments: argparse.Namespace) -> int:
    if arguments.plan:
        return _plan(arguments)
    _refuse(arguments, _PLAN_OPTIONS, "needs --plan")
    if len(arguments.case) + (arguments.from_log is not None) != 1 or arguments.scheduler:
        return _diagnose_all(arguments)
    with needs_analysis():
        from flying_vines.identification.case import CaseError
        from flying_vines.identification.diagnose import diagnose
        from flying_vines.identification.from_log import read_flight
        from flying_vines.identification.parallel_diagnosis import read_any
        from flying_vines.identification.show import show
        from flying_vines.identification.verdict import extended_rig
        from flying_vines.physics.plant.true_rig import true_rig_text
        from flying_vines.physics.rig import RigError

        if arguments.out:
            from flying_vines.identification.report import write_report
    from rich.console import Console

    with file_errors(arguments.write_rig, CaseError, RigError):
        if arguments.from_log:
            case = read_flight(arguments.from_log, arguments.rig)
        else:
            case = read_any(arguments.case[0], arguments.rig)
        if arguments.out:
            # An unwritable folder must fail before the long computation.
            arguments.out.mkdir(parents=True, exist_ok=True)
        with needs_analysis(), progress_bar() as progress:
            verdict = diagnose(case, progress=progress)
        if arguments.write_rig:
            arguments.write_rig.write_text(true_rig_text(extended_rig(case.rig, verdict)), encoding="utf-8")
        files = write_report(verdict, case, arguments.out) if arguments.out else []
    if arguments.json:
        print(json.dumps(verdict.as_json(), allow_nan=False))
        return 0
    console = Console(markup=False)
    show(verdict, console)
    if files:
        console.print(f"Report   {files[0]}", highlight=False, soft_wrap=True)
    return 0


def _refuse(arguments: argparse.Namespace, options: Sequence[str], why: str) -> None:
    """Fail if one of these options is given."""
    for option in options:
        if getattr(arguments, option) not in (None, []):
            fail(f"--{option.replace('_', '-')} {why}")


def _plan(arguments: argparse.Namespace) -> int:
    _refuse(arguments, _NOT_FOR_PLANS, "cannot be used with --plan")
    if len(arguments.case) != 1:
        fail("--plan needs one CASE: the rig.toml of the assumed rig")
    with needs_analysis():
        from flying_vines.identification.plan import RecordingPlanError, plan
        from flying_vines.identification.plan.show import figures, show, write_plan
        from flying_vines.physics.rig import RigError, load_rig
        from flying_vines.plots.style import save

    folder: Path | None = arguments.out
    limits = {name: getattr(arguments, name) for name in _PLAN_OPTIONS}
    with file_errors(folder, RecordingPlanError, RigError):
        rig = load_rig(arguments.case[0])
        with needs_analysis(), progress_bar() as progress:
            found = plan(rig, **{k: v for k, v in limits.items() if v is not None}, progress=progress)
        files = write_plan(found, folder) if folder else []
        drawn = save(figures(found), folder, "plan") if folder else []

    def shown(console: Console) -> None:
        show(found, console)
        for path in files:
            console.print(f"Written  {path}", highlight=False, soft_wrap=True)

    written = {"files": [str(path) for path in files]}
    return show_found(arguments.json, lambda: {**found.as_json(), **written}, shown, drawn)


def _diagnose_all(arguments: argparse.Namespace) -> int:
    _refuse(arguments, _SINGLE_OPTIONS, "needs exactly one case and no --scheduler")
    if not arguments.case:
        fail("diagnose needs a CASE, or a flight log: --from-log LOG")
    with needs_analysis():
        from flying_vines.identification.parallel_diagnosis import ClusterError, diagnose_all
        from flying_vines.identification.show import show_all
    from rich.console import Console

    outcomes = diagnose_all(arguments.case, scheduler=arguments.scheduler, rig=arguments.rig)
    with file_errors(arguments.case[0], ClusterError):
        every = show_all(outcomes, len(arguments.case), arguments.json, Console(markup=False))
    return 0 if every else BAD_INPUT
