"""The distance of two causes by a full fit, as in a diagnosis. It checks the distance from the traces.

The runs of a plan are simulated with cause A in the rig, without noise, with the inputs of the nominal rig.
Cause B is fitted to them as in a diagnosis: its strength, the rig numbers within their tolerances, and all
initial pressures. The fit starts at the strength at which B's trace is most similar to A's. The remaining
cost is Δχ².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from flying_vines.identification.case import Case
from flying_vines.identification.fit import FitProblem
from flying_vines.identification.plan.cause_distance import nearest
from flying_vines.identification.plan.nominal_run import nominal_run
from flying_vines.identification.plan.traces import CandidatePart, Layout
from flying_vines.identification.simulate import Simulation


class FullFits:
    """Full fits to the simulated readings of one plan."""

    def __init__(self, layout: Layout, parts: Sequence[CandidatePart]) -> None:
        self._layout = layout
        self._runs = tuple(nominal_run(layout.rig, part.kind) for part in parts)
        self._initial = [np.array([[part.kind.reservoir_kPa, 0.0]]) for part in parts]
        self._gram = sum((part.gram for part in parts), start=layout.nothing)

    def distance(self, there: int, fitted: int) -> float:
        """Δχ² if `there` is in the rig and `fitted` is fitted; both are column numbers of the matrix."""
        layout = self._layout
        problem = FitProblem(self._case(there), layout.noise)
        start = replace(problem.start().freed(layout.keys), initial=np.concatenate(self._initial))
        for known, values in layout.known:
            start = start.with_cause(known, values)
        if fitted < len(layout.causes):
            cause = layout.causes[fitted]
            value = nearest(layout, self._gram, there, fitted)
            start = start.with_cause(cause, (value, *layout.rest[fitted]))
        return problem.fit(start).cost

    def _case(self, there: int) -> Case:
        layout = self._layout
        cause = layout.causes[there]
        value = layout.values[there][layout.usual[there] - layout.first[there]]
        causes = [*layout.known, (cause, (value, *layout.rest[there]))]
        bare = Case(Path("plan"), layout.rig, self._runs, ())
        simulation = Simulation(bare)
        runs = []
        for index, (run, initial) in enumerate(zip(self._runs, self._initial, strict=True)):
            readings = simulation.readings(index, {}, causes, initial)
            cv_kPa = np.full_like(run.time_s, np.nan) if run.to_atmosphere else readings.cv_kPa
            runs.append(replace(run, cv_kPa=cv_kPa, reservoir_kPa=readings.reservoir_kPa))
        return replace(bare, runs=tuple(runs))
