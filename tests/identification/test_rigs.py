"""A few lines of rig.toml describe a rig, which is simulated, recorded, read and fitted."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from flying_vines.identification.case import read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.importing.rig_guess import guessed_pump
from flying_vines.physics.effects import cause_named
from flying_vines.physics.plant.true_rig import true_rig_from
from flying_vines.simulation.scenario import parse_scenario, simulate_scenario, write_case
from flying_vines.simulation.scenario.scenario import ScenarioError

PUMP = "[cv]\nvolume_L = 0.2\n[pump]\nfree_flow_SL_per_s = 0.05\nstall_pressure_kPa = 40\n"
OPENINGS = '[[runs]]\nkind = "openings"\nreservoir_kPa = {reservoir_kPa}\nvalves = [{valves}]\n'
FILLED = "{ for_s = 1.5, evp = 1 }, { for_s = 15 }, { for_s = 1, evp = 0.6 }, { for_s = 1, solenoid = true }"
RIGS = {
    "held chamber": ("[cv]\nvolume_L = 0.4\n", 650.0, "{ for_s = 0.5, evp = 1 }, { for_s = 20 }", "cv_leak"),
    "held vessel": ("[reservoir]\nvolume_L = 0.4\n", 300.0, "{ for_s = 20 }", "reservoir_leak"),
    "discharge": ("[reservoir]\nvolume_L = 1.5\n", 600.0, "{ for_s = 20, evp = 1 }", "evp_restriction"),
    "pump into a chamber": (PUMP, 100.0, FILLED, "pump_flow"),
    "two vessels": (
        "[reservoir]\nvolume_L = 2\n[cv]\nvolume_L = 0.5\n"
        "[hose]\nvolume_L = 0.3\nflow_resistance_kPa_s_per_SL = 200\n",
        600.0,
        FILLED,
        "reservoir_volume",
    ),
}
SUSPECTS = ("cv_leak", "reservoir_leak", "evp_restriction", "pump_flow", "reservoir_volume")


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in RIGS if name != "held vessel"])
def test_a_described_rig_is_simulated_and_fitted(name: str, tmp_path: Path) -> None:
    rig, reservoir_kPa, valves, _ = RIGS[name]
    scenario = parse_scenario(OPENINGS.format(reservoir_kPa=reservoir_kPa, valves=valves), name)
    runs = simulate_scenario(true_rig_from(tomllib.loads(rig)), scenario, seed=3)
    write_case(runs, rig.encode(), tmp_path / "case")
    case = read_case(tmp_path / "case")
    verdict = diagnose(case, [cause_named(suspect) for suspect in SUSPECTS])
    assert verdict.cause == "none"
    assert verdict.held_out.nrmse_after == pytest.approx(verdict.held_out.noise_floor, rel=0.2)


@pytest.mark.long
@pytest.mark.parametrize("name", RIGS)
def test_the_fault_of_a_described_rig_is_found(name: str, tmp_path: Path) -> None:
    rig, reservoir_kPa, valves, cause = RIGS[name]
    value = 2e3 if cause.endswith("leak") else 1.3
    parameter = cause_named(cause).parameters[0].name
    hidden = tomllib.loads(rig) | {"causes": {cause: {parameter: value}}}
    scenario = parse_scenario(OPENINGS.format(reservoir_kPa=reservoir_kPa, valves=valves), name)
    runs = simulate_scenario(true_rig_from(hidden), scenario, seed=4)
    write_case(runs, rig.encode(), tmp_path / "case")
    verdict = diagnose(read_case(tmp_path / "case"), [cause_named(suspect) for suspect in SUSPECTS])
    assert cause in (verdict.cause, *verdict.indistinguishable)
    if verdict.cause == cause:
        assert verdict.parameters[parameter].estimate == pytest.approx(value, rel=0.1)


def test_a_regulated_run_needs_valves() -> None:
    text = '[[runs]]\nkind = "steps"\npressures_kPa = [20]\nhold_s = 2\n'
    with pytest.raises(ScenarioError, match="the rig has a pump"):
        simulate_scenario(true_rig_from(tomllib.loads(PUMP)), parse_scenario(text, "steps"))


def test_a_pump_is_guessed_from_the_rise_of_its_chamber() -> None:
    text = OPENINGS.format(reservoir_kPa=100, valves=FILLED.replace("1.5", "3"))
    (run,) = simulate_scenario(true_rig_from(tomllib.loads(PUMP)), parse_scenario(text, "fill"), seed=1)
    columns = {
        "time": run.time_s,
        "cv_pressure": run.cv_pressure_kPa,
        "evp_opening": run.evp_opening,
        "solenoid": run.solenoid.astype(float),
    }
    found = guessed_pump([columns], 0.2)
    assert found["free_flow_SL_per_s"] == pytest.approx(0.05, rel=0.2)
    assert found["stall_pressure_kPa"] == pytest.approx(40.0, rel=0.2)
    still = {**columns, "cv_pressure": np.zeros_like(run.time_s)}
    assert guessed_pump([still], 0.2) == {"free_flow_SL_per_s": 0.04, "stall_pressure_kPa": 60.0}
