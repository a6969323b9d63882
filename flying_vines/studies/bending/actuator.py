"""What a contracting actuator is to a vine: a force against a contraction, and the air that it holds.

An inflated actuator bulges, and as it bulges it shortens. Each kind describes itself by its bulge, 0…1,
from barely filled to the shape it takes when nothing pulls on it: there force, length, volume and film
stretch are closed forms, while force against contraction is not. The functions below turn one into the
other.

All kinds keep the balance of virtual work: what the gas does, p dV, is what the load receives and what the
film stores, p dV = −F dL + dU, so that F = (dU − p dV)/dL at constant pressure.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, NamedTuple, Protocol

import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike, NDArray

from flying_vines.physics.arrays import Array

Size = Annotated[float, Meta(ge=0.1, le=10000)]
"""mm."""


HALVINGS = 60
"""Of an interval of bulges: down to the rounding of a float."""
MOST_KPA = 1000.0
"""Where the search for a bursting pressure ends."""


class ActuatorState(NamedTuple):
    """An actuator at a pressure and a bulge."""

    contraction: Array
    """Share of the length at rest; below 0 the film is stretched beyond it."""
    force_N: Array
    """With which it pulls its ends together."""
    volume_L: Array
    elastic_J: Array
    """U, stored in its film."""
    film_N_per_m: Array
    """The greatest tension in the film, per length across it."""


class Actuator(Protocol):
    """A series of contracting units along one side of a vine, from its base to its tip."""

    @property
    def length_m(self) -> float:
        """Of the whole series, flat."""

    @property
    def strength_N_per_mm(self) -> float:
        """The film tension that its seams bear."""

    def state(self, pressure_kPa: ArrayLike, bulge: ArrayLike) -> ActuatorState:
        """At a gauge pressure and a bulge in (0, 1]. Force falls and contraction rises with the bulge."""


def bulge_where(
    crossed: Callable[[Array], NDArray[np.bool_]], shape: tuple[int, ...], from_: float = 0.0
) -> Array:
    """The bulge from which on `crossed` holds, by bisection; 1 where it never does."""
    low, high = np.full(shape, from_), np.ones(shape)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        beyond = crossed(middle)
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return high


def held_at(actuator: Actuator, pressure_kPa: ArrayLike, contraction: ArrayLike) -> ActuatorState:
    """The actuator at a gauge pressure, its ends held at a contraction; beyond the free one, free.

    Args:
        actuator: of any kind.
        pressure_kPa: gauge.
        contraction: share of its length at rest.
    """
    kPa, held = np.broadcast_arrays(np.asarray(pressure_kPa, float), np.asarray(contraction, float))
    bulge = bulge_where(lambda x: actuator.state(kPa, x).contraction >= held, kPa.shape)
    return actuator.state(kPa, bulge)


def force_N(actuator: Actuator, pressure_kPa: ArrayLike, contraction: ArrayLike) -> Array:
    """The pull at a gauge pressure and a contraction, N."""
    return held_at(actuator, pressure_kPa, contraction).force_N


def volume_L(actuator: Actuator, pressure_kPa: ArrayLike, contraction: ArrayLike) -> Array:
    """The volume at a gauge pressure and a contraction, L."""
    return held_at(actuator, pressure_kPa, contraction).volume_L


def free(actuator: Actuator, pressure_kPa: ArrayLike) -> ActuatorState:
    """The actuator when nothing pulls on it: the greatest contraction that a pressure brings."""
    kPa = np.asarray(pressure_kPa, float)
    return actuator.state(kPa, bulge_where(lambda x: actuator.state(kPa, x).force_N <= 0.0, kPa.shape))


def burst_kPa(actuator: Actuator) -> float:
    """The gauge pressure at which the film of a free actuator bears no more; an estimate, thin-walled.

    Held back it bears less: its film is flatter there, and a flat film is under more tension.
    """
    low, high = 0.0, MOST_KPA
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        torn = float(free(actuator, middle).film_N_per_m) >= 1000.0 * actuator.strength_N_per_mm
        low, high = (low, middle) if torn else (middle, high)
    return high
