"""`flying-vines log`: list, show, plot, export and bundle recorded flights."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flying_vines.cli.common import FLIGHTS, add_option, bad_input, file_errors, needs_analysis

if TYPE_CHECKING:
    from flying_vines.record.reader import FlightLog

PICTURES = (".png", ".pdf", ".svg")


def add(commands: Any) -> None:
    """Add `log` to the parsers of the command line."""
    log = commands.add_parser("log", help="recorded flights: list, show, plot, export, bundle")
    actions = log.add_subparsers(required=True, metavar="ACTION")

    listing = actions.add_parser("list", help="print one line per flight")
    listing.add_argument(
        "folder", type=Path, nargs="?", default=FLIGHTS, metavar="DIR", help="folder of the flights (flights)"
    )
    add_option(listing, "--json", help="print a JSON array instead")
    listing.set_defaults(run=_list)

    show = _add_action(actions, "show", _show, "print decisions, notices and a summary")
    add_option(show, "--json")
    plot = _add_action(actions, "plot", _plot, "draw the flight: .png, .pdf or .svg")
    add_option(plot, "-o", "--out", metavar="FILE", help="the picture (flight.png in the flight's folder)")
    plot.add_argument("--title", metavar="TEXT", help="the picture's title (date and time of the flight)")
    export = _add_action(actions, "export", _export, "write tables for other programs")
    export.add_argument("--csv", action="store_true", help="one CSV file per topic (the default)")
    add_option(export, "-o", "--out", help="new folder (csv in the flight's folder)")
    bundle = _add_action(actions, "bundle", _bundle, "pack the flight into a zip file for a bug report")
    add_option(bundle, "-o", "--out", metavar="FILE.zip", help="the new file (here, named after the flight)")


def _add_action(
    actions: Any, name: str, run: Callable[[FlightLog, argparse.Namespace], int], what: str
) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = actions.add_parser(name, help=what)
    parser.add_argument("flight", metavar="FLIGHT", help="the flight's folder or flight.mcap, or 'last'")
    parser.add_argument(
        "--in",
        type=Path,
        default=FLIGHTS,
        dest="folder",
        metavar="DIR",
        help="folder of the flights (flights)",
    )
    parser.set_defaults(run=lambda arguments: _reading(run, arguments))
    return parser


def _reading(run: Callable[[FlightLog, argparse.Namespace], int], arguments: argparse.Namespace) -> int:
    """Find the flight and run the action; a file error becomes one line."""
    from flying_vines.record.reader import LogError, find_flight, refuses_foreign

    with needs_analysis(), file_errors(arguments.folder, LogError):
        log = find_flight(arguments.flight, arguments.folder)
        with refuses_foreign(log):
            status = run(log, arguments)
    if log.damage:
        print(f"flying-vines: {log.damage}", file=sys.stderr)
    return status


def _list(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from flying_vines.cli.log_tables import summary_as_json, summary_table
    from flying_vines.record.reader import FlightLog, LogError, flights_in, refuses_foreign, summarise

    if not arguments.folder.is_dir():
        return bad_input(f"{arguments.folder}: is not a folder; `run` and `demo` write flights there")
    summaries, unreadable = [], []
    for folder in flights_in(arguments.folder):
        try:
            log = FlightLog(folder)
            with refuses_foreign(log):
                summaries.append(summarise(log))
        except LogError as error:
            unreadable.append(str(error))
    if arguments.json:
        print(json.dumps([summary_as_json(summary) for summary in summaries]))
    elif summaries:
        Console(markup=False).print(summary_table(summaries))
    else:
        print(f"{arguments.folder}: no flights yet")
    for why in unreadable:
        print(f"flying-vines: {why}", file=sys.stderr)
    return 0


def _show(log: FlightLog, arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from flying_vines.cli.log_tables import events_as_json, show_events

    if arguments.json:
        print(json.dumps(events_as_json(log), allow_nan=False))
    else:
        show_events(log, Console(markup=False))
    return 0


def _plot(log: FlightLog, arguments: argparse.Namespace) -> int:
    from flying_vines.record.picture import draw_flight

    path: Path = arguments.out or log.folder / "flight.png"
    if path.suffix.casefold() not in PICTURES:
        return bad_input(f"{path}: the name of a picture must end with one of {', '.join(PICTURES)}")
    draw_flight(log, path, arguments.title)
    print(f"Picture  {path}")
    return 0


def _export(log: FlightLog, arguments: argparse.Namespace) -> int:
    from flying_vines.record.export import export_csv

    folder: Path = arguments.out or log.folder / "csv"
    folder.mkdir(parents=True, exist_ok=True)
    paths = export_csv(log, folder)
    print(f"Wrote {len(paths)} tables into {folder}")
    return 0


def _bundle(log: FlightLog, arguments: argparse.Namespace) -> int:
    import io

    from rich.console import Console

    from flying_vines.cli.log_tables import show_events
    from flying_vines.record.export import bundle

    path: Path = arguments.out or Path(f"{log.folder.resolve().name}.zip")
    text = io.StringIO()
    show_events(log, Console(markup=False, file=text, width=120))
    names = bundle(log, text.getvalue(), path)
    print(f"Wrote {path}: {', '.join(names)}")
    return 0
