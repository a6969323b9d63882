"""`flying-vines simulate`: simulates a rig in a scenario."""

from __future__ import annotations

import argparse
from pathlib import Path
from time import monotonic
from typing import Any

from flying_vines.cli.common import add_cause_option, fail, file_errors, needs_analysis


def add(commands: Any) -> None:
    """Add `simulate` to the parsers of the command line."""
    simulate = commands.add_parser("simulate", help="simulate a rig in a scenario, and write recorded runs")
    simulate.add_argument("--rig", type=Path, required=True, metavar="RIG.toml", help="the simulated rig")
    simulate.add_argument(
        "--scenario", required=True, metavar="FILE", help="file, or an example: case, discharge"
    )
    simulate.add_argument("--out", type=Path, required=True, metavar="DIR", help="the case folder")
    simulate.add_argument("--seed", type=int, default=1, metavar="N", help="seed of all random numbers (1)")
    add_cause_option(simulate)
    simulate.set_defaults(run=_simulate)


def _simulate(arguments: argparse.Namespace) -> int:
    from flying_vines.files.bounded import read_bytes
    from flying_vines.physics.plant.true_rig import TrueRig, load_true_rig, true_rig_text
    from flying_vines.physics.rig import RigError, load_rig

    folder: Path = arguments.out
    with needs_analysis():
        from flying_vines.simulation.scenario import (
            CaseFolderError,
            ScenarioError,
            load_scenario,
            simulate_scenario,
            write_case,
        )
        from flying_vines.simulation.scenario.picture import draw_runs
    with file_errors(folder, RigError, ScenarioError, CaseFolderError):
        rig = load_true_rig(arguments.rig)
        scenario = load_scenario(arguments.scenario)
        began_s = monotonic()
        try:
            runs = simulate_scenario(rig, scenario, arguments.seed)
        except ScenarioError as error:
            fail(f"{arguments.scenario}: {error}")
        took_s = monotonic() - began_s
        given = read_bytes(arguments.rig)
        try:
            load_rig(arguments.rig)
            paths = write_case(runs, given, folder)
        except RigError:
            paths = write_case(runs, true_rig_text(TrueRig(rig.nominal)).encode(), folder, given)
        picture = folder / "picture.png"
        draw_runs(runs, picture, scenario.name or str(arguments.scenario))
    for path, run in zip(paths, runs, strict=True):
        print(f"Run      {path}" + (f"  the firmware vented: {run.faults}" if run.faults else ""))
    print(f"Picture  {picture}")
    simulated_s = sum(run.length_s for run in scenario.runs)
    print(
        f"{simulated_s:.0f} s of the rig, simulated at {simulated_s / max(took_s, 1e-9):.0f} times real time."
    )
    return 0
