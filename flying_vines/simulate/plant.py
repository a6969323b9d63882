"""What a plant is to the simulation, and the baseline as one."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import Protocol

from flying_vines.pneumatics import baseline
from flying_vines.pneumatics.baseline import ALPHA_KPA, Inputs, State
from flying_vines.pneumatics.rig import Rig


class Plant(Protocol):
    """Valves and air, at some state. Real valves remember, so a plant keeps its state to itself."""

    def advance(self, inputs: Inputs, dt_s: float) -> State:
        """The true pressures `dt_s` later, for which the valves are told `inputs`."""


PlantMaker = Callable[[Rig, State], Plant]
"""A plant at rest with these pressures."""

StepFunction = Callable[[Rig, State, Inputs, float], State]

_LONGEST_STEP = 0.5
"""In quickest time constants, where Runge–Kutta of fourth order errs by 2e-4 of what is left to settle."""


class BaselinePlant:
    """The baseline, or any plant of two pressures whose `step` is a function like the baseline's."""

    def __init__(self, rig: Rig, state: State, step: StepFunction = baseline.step) -> None:
        self._rig = rig
        self._state = state
        self._step = step
        self._fastest_per_s = _fastest_per_s(rig)

    def advance(self, inputs: Inputs, dt_s: float) -> State:
        parts = max(1, ceil(self._fastest_per_s * dt_s / _LONGEST_STEP))
        for _ in range(parts):
            self._state = self._step(self._rig, self._state, inputs, dt_s / parts)
        return self._state


def _fastest_per_s(rig: Rig) -> float:
    """The sum of all rates with every valve open, above the quickest of them."""
    per_litre = 1.0 / rig.evp.flow_resistance_kPa_s_per_SL
    reservoir = (per_litre + 1.0 / rig.dvp.flow_resistance_kPa_s_per_SL) / rig.reservoir.volume_L
    if rig.cv is None:
        return ALPHA_KPA * reservoir
    cv = (per_litre + 1.0 / rig.solenoid.flow_resistance_kPa_s_per_SL) / rig.cv.volume_L
    return ALPHA_KPA * (reservoir + cv)
