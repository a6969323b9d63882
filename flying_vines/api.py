"""The Python interface for researchers. A name is imported at its first use.

from flying_vines import api

case = api.read_case("cases/workshop")
verdict = api.diagnose(case)
rig = api.extended_rig(case.rig, verdict)
runs = api.simulate(rig, api.load_scenario("case"))
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flying_vines.identification.diagnose import diagnose
    from flying_vines.identification.parallel_diagnosis import read_any as read_case
    from flying_vines.identification.plan import plan, recommend
    from flying_vines.identification.report import write_report
    from flying_vines.identification.verdict import extended_rig
    from flying_vines.physics.cause import Cause, Parameter, read_causes
    from flying_vines.physics.effects import add_causes, causes_of
    from flying_vines.physics.plant.leak import curve_of
    from flying_vines.physics.plant.true_rig import load_true_rig as load_rig
    from flying_vines.physics.plant.true_rig import true_rig_text as rig_text
    from flying_vines.record.arrays import read_flight, read_tlog
    from flying_vines.simulation.scenario import load_scenario
    from flying_vines.simulation.scenario import simulate_scenario as simulate
    from flying_vines.studies.design import evaluate as design

_MODULES = {
    "read_case": "identification.parallel_diagnosis:read_any",
    "read_flight": "record.arrays:read_flight",
    "read_tlog": "record.arrays:read_tlog",
    "load_rig": "physics.plant.true_rig:load_true_rig",
    "rig_text": "physics.plant.true_rig:true_rig_text",
    "load_scenario": "simulation.scenario:load_scenario",
    "simulate": "simulation.scenario:simulate_scenario",
    "diagnose": "identification.diagnose:diagnose",
    "add_causes": "physics.effects:add_causes",
    "causes_of": "physics.effects:causes_of",
    "Cause": "physics.cause:Cause",
    "Parameter": "physics.cause:Parameter",
    "curve_of": "physics.plant.leak:curve_of",
    "read_causes": "physics.cause:read_causes",
    "extended_rig": "identification.verdict:extended_rig",
    "write_report": "identification.report:write_report",
    "plan": "identification.plan:plan",
    "recommend": "identification.plan:recommend",
    "design": "studies.design:evaluate",
}
"""For each name: its module, and its name in that module."""

__all__ = [
    "Cause",
    "Parameter",
    "add_causes",
    "causes_of",
    "curve_of",
    "design",
    "diagnose",
    "extended_rig",
    "load_rig",
    "load_scenario",
    "plan",
    "read_case",
    "read_causes",
    "read_flight",
    "read_tlog",
    "recommend",
    "rig_text",
    "simulate",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"flying_vines.api has no {name}")
    module, _, attribute = _MODULES[name].partition(":")
    return getattr(import_module(f"flying_vines.{module}"), attribute)


def __dir__() -> list[str]:
    return __all__
