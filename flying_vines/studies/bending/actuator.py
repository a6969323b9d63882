"""A contracting actuator: force over contraction, and the air in it.

An inflated actuator bulges and becomes shorter. Each kind is described by its bulge, 0…1, from barely filled
to its free shape without load. Force, length, volume and film stretch are closed forms of the bulge; force
over contraction is not. So the functions below search for the bulge that gives a contraction or a force.

All kinds satisfy virtual work: the work of the gas p dV goes into the load and the film, p dV = −F dL + dU.
So F = (dU − p dV)/dL at constant pressure.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, NamedTuple, Protocol

import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike

from flying_vines.physics.arrays import Array, BoolArray

Size = Annotated[float, Meta(ge=0.1, le=10000)]
"""A size within plausible bounds, in the unit of its name."""
HALVINGS = 60
"""Bisection steps, down to the rounding of a float."""
MAX_KPA = 1000.0
"""Upper end of the search for a bursting pressure, gauge."""


class ActuatorState(NamedTuple):
    """An actuator at a pressure and a bulge."""

    contraction: Array
    """Share of the flat length; negative if the film is stretched beyond it."""
    force_N: Array
    """Pull on its ends."""
    volume_L: Array
    elastic_J: Array
    """U, the elastic energy of the film."""
    film_N_per_m: Array
    """Maximum film tension per width."""


class BendingActuator(Protocol):
    """A series of contracting units along one side of a vine, from its base to its tip."""

    @property
    def length_m(self) -> float:
        """Flat length of the whole series."""

    @property
    def strength_N_per_mm(self) -> float:
        """Film tension at which the film or a seam tears."""

    def state(self, pressure_kPa: ArrayLike, bulge: ArrayLike) -> ActuatorState:
        """State at a gauge pressure and a bulge in (0, 1]: more bulge is less force and more contraction."""


def bulge_where(crossed: Callable[[Array], BoolArray], shape: tuple[int, ...]) -> Array:
    """The smallest bulge for which `crossed` is true, by bisection; 1 if it never is."""
    low, high = np.zeros(shape), np.ones(shape)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        beyond = crossed(middle)
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return high


def held_at(actuator: BendingActuator, pressure_kPa: ArrayLike, contraction: ArrayLike) -> ActuatorState:
    """The actuator at a gauge pressure and a contraction; at a bulge of 1 if it cannot contract that much."""
    kPa, held = np.broadcast_arrays(np.asarray(pressure_kPa, float), np.asarray(contraction, float))
    bulge = bulge_where(lambda x: actuator.state(kPa, x).contraction >= held, kPa.shape)
    return actuator.state(kPa, bulge)


def force_N(actuator: BendingActuator, pressure_kPa: ArrayLike, contraction: ArrayLike) -> Array:
    """The pull at a gauge pressure and a contraction, N."""
    return held_at(actuator, pressure_kPa, contraction).force_N


def volume_L(actuator: BendingActuator, pressure_kPa: ArrayLike, contraction: ArrayLike) -> Array:
    """The volume at a gauge pressure and a contraction, L."""
    return held_at(actuator, pressure_kPa, contraction).volume_L


def free(actuator: BendingActuator, pressure_kPa: ArrayLike) -> ActuatorState:
    """The actuator without load, at its maximum contraction."""
    kPa = np.asarray(pressure_kPa, float)
    return actuator.state(kPa, bulge_where(lambda x: actuator.state(kPa, x).force_N <= 0.0, kPa.shape))


def burst_kPa(actuator: BendingActuator) -> float:
    """The gauge pressure at which the film of a free actuator tears; a thin-wall estimate.

    A loaded actuator tears at a lower pressure: its film is flatter and so has more tension.
    """
    low, high = 0.0, MAX_KPA
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        torn = float(free(actuator, middle).film_N_per_m) >= 1000.0 * actuator.strength_N_per_mm
        low, high = (low, middle) if torn else (middle, high)
    return high
