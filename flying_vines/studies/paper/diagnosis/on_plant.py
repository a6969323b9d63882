"""The discharges on the high-fidelity plant: heat through a fixed hA, and flow that goes with 1/√θ.

The engine's own cooling has one time constant, as if the wall's conductance went with the mass of gas that is
left. Whether a finding about flow stands with the other law of heat as well, only the plant can tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np

from flying_vines.identification.fit import FitPoint
from flying_vines.physics.arrays import Array
from flying_vines.physics.baseline import Inputs
from flying_vines.physics.cause import ModelReadings
from flying_vines.physics.plant.compiled import replay
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.flow import Ohm, iso6358_matching
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.wall import PET_BOTTLE_2L
from flying_vines.physics.rig import Evp, with_numbers
from flying_vines.studies.paper.diagnosis.correlated import Correlated

TICK_S = 0.25
SIMULATED = ("evp_restriction", "reservoir_wall", "compressible_flow", "reservoir_leak")
"""The causes that are known here, beside those of the sensors."""


class OnPlant(Correlated):
    """The same readings, simulated by the plant."""

    def simulated(self, point: FitPoint, runs: Sequence[int] | None = None) -> list[Array]:
        """Readings of these runs: (2, n), of which the first row says nothing."""
        every = list(zip(point.causes, point.values, strict=True))
        given = {cause.name: values[0] for cause, values in every if cause.readings is None}
        if unknown := given.keys() - set(SIMULATED):
            raise ValueError(f"the plant's discharge knows no {', '.join(sorted(unknown))}")
        resistance = with_numbers(
            self.case.rig, self.moved(point)
        ).evp.flow_resistance_kPa_s_per_SL * given.get("evp_restriction", 1.0)
        law = wall = leak = None
        if "compressible_flow" in given:
            law = iso6358_matching(resistance, critical_pressure_ratio=given["compressible_flow"])
        if "reservoir_wall" in given:
            wall = replace(PET_BOTTLE_2L, conductance_W_per_K=given["reservoir_wall"])
        if "reservoir_leak" in given:
            leak = Ohm(given["reservoir_leak"])
        rig = replace(self.case.rig, evp=Evp(resistance))
        plant = Plant(rig, Effects(evp_law=law, reservoir_wall=wall, reservoir_leak=leak))
        found = []
        for index in range(len(self.data)) if runs is None else runs:
            run = self.case.runs[index]
            opening = float(run.evp_opening[0])
            ticks = ceil(run.time_s[-1] / TICK_S) + 2
            table = replay(
                plant,
                np.tile((opening, 0.0, 0.0), (ticks, 1)),
                at_rest(plant, float(point.initial[self.starts[index]][0, 0])),
                initial=Inputs(opening, 0.0, False),
                tick_s=TICK_S,
            ).table
            kPa = np.interp(run.time_s, TICK_S * np.arange(ticks), table["reservoir_kPa"])
            readings = ModelReadings(np.zeros_like(kPa), kPa)
            for cause, values in every:
                if cause.readings is not None:
                    readings = cause.readings(readings, values)
            found.append(np.stack(readings))
        return found
