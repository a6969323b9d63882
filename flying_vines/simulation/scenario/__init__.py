"""Simulates the runs of a scenario on a rig, and records them like runs of a real rig.

    scenario = load_scenario("case")                        a file, or an example by its name
    run = simulate(rig, scenario.runs[0], seed=1)           one run, as arrays
    runs = simulate_scenario(rig, scenario, seed=1)         all of them
    write_case(runs, rig_toml, folder)                      a case folder
    picture.draw_runs(runs, path, title)                    a picture (needs matplotlib)

A `Rig` is simulated with the baseline model, a `TrueRig` with its true numbers and effects. `simulate` needs
numpy.
"""

from __future__ import annotations

from flying_vines.simulation.scenario.run import ScenarioRun, simulate, simulate_scenario
from flying_vines.simulation.scenario.scenario import Scenario, ScenarioError, load_scenario, parse_scenario
from flying_vines.simulation.scenario.write import CaseFolderError, case_files, csv_text, write_case

__all__ = [
    "CaseFolderError",
    "Scenario",
    "ScenarioError",
    "ScenarioRun",
    "case_files",
    "csv_text",
    "load_scenario",
    "parse_scenario",
    "simulate",
    "simulate_scenario",
    "write_case",
]
