"""The flows of the plant, with names."""

from __future__ import annotations

from typing import NamedTuple

from flying_vines.physics.plant.ambient import Air
from flying_vines.physics.plant.numbers import PlantNumbers
from flying_vines.physics.plant.plant import Held
from flying_vines.physics.plant.rates import Floats, balance


class Flows(NamedTuple):
    """Flows in standard litres per second, and heat into the gas in W.

    Each `…_ratio` is the temperature of the flowing gas over 293.15 K.
    """

    inflation_SL_per_s: float
    inflation_ratio: float
    motive_SL_per_s: float
    motive_ratio: float
    outlet_SL_per_s: float
    outlet_ratio: float
    reservoir_leak_SL_per_s: float
    reservoir_leak_ratio: float
    cv_leak_SL_per_s: float
    cv_leak_ratio: float
    line_to_cv_SL_per_s: float
    line_to_cv_ratio: float
    reservoir_heat_W: float
    cv_heat_W: float


def flows(numbers: PlantNumbers, air: Air, at_s: float, state: Floats, held: Held) -> Flows:
    """All flows at time `at_s` after the start of `air`."""
    found = balance(numbers, air, at_s, state, held)
    g = numbers.gamma - 1.0
    return Flows._make((*found[:12], found[12] / g, found[13] / g))
