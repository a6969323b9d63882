"""A vine's bend against its actuator's pressure: where the actuator's pull is what the body yields to.

The actuator pulls less the more it is contracted, the body needs more pull the more it is bent: for each
pressure there is one bend, and more pressure bends it further. Gravity is left out; for a vine this light
it matters little (Kübler et al. 2023).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flying_vines.physics.arrays import Array
from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.studies.bending.actuator import bulge_where, free
from flying_vines.studies.bending.description import BendingVine
from flying_vines.vine.shape import tip

SATURATED = 0.95
"""Of the contraction that the actuator would have with nothing pulling on it: more pressure brings little."""
POINTS = 240

LimitName = Literal["wrinkling", "collapse", "axial", "contraction", "burst"]


class Limit(NamedTuple):
    """Something that a rising pressure meets."""

    name: LimitName
    pressure_kPa: float | None
    """Of the actuator, gauge, from which on it holds; none within what the supply gives."""
    reason: str
    ends: bool
    """Whether it ends what the vine can be used for. Wrinkling does not: every vine bends by it."""


@dataclass(frozen=True)
class BendingCurve:
    """A vine over rising pressures in its actuator. Gauge kPa; each array has a value for each pressure."""

    vine: BendingVine
    pressure_kPa: Array
    contraction: Array
    """Share of the actuator's length."""
    curvature_per_m: Array
    angle_deg: Array
    """Of the tip against the base."""
    force_N: Array
    """The actuator's pull."""
    volume_L: Array
    """Of the actuator, which lies flat without pressure."""
    film_N_per_mm: Array
    """The greatest tension in the actuator's film."""
    free_contraction: Array
    """What the actuator would do with nothing pulling on it."""

    @cached_property
    def air_SL(self) -> Array:
        """The air in the actuator, standard litres: V (P_a + P)/α, isothermal; at first it lies flat."""
        return self.volume_L * (self.vine.ambient_kPa + self.pressure_kPa) / ALPHA_KPA

    @cached_property
    def length_m(self) -> Array:
        """Of the axis, from base to tip: shorter than the taut outer side."""
        body, length = self.vine.body, self.vine.actuator.length_m
        return length * (1.0 - self.contraction) + np.radians(self.angle_deg) * body.lever_m

    @cached_property
    def tip_m(self) -> Array:
        """x, to the side, and y, along the base's direction: a row for each pressure."""
        pairs = zip(self.angle_deg.tolist(), self.length_m.tolist(), strict=True)
        return np.array([tip(angle, length)[:2] for angle, length in pairs])

    @cached_property
    def tip_load_N(self) -> Array:
        """What load across the tip the bent vine bears at its base, in the worst direction.

        Conservative: the actuator's pull is taken as it is, while it falls as the vine gives way.
        """
        return self.vine.body.tip_load_N(self.vine.actuator.length_m, self.force_N)

    @cached_property
    def limits(self) -> tuple[Limit, ...]:
        """All limits, in the order of their pressures; those that are not met come last."""
        return tuple(
            sorted(_limits(self), key=lambda limit: (limit.pressure_kPa is None, limit.pressure_kPa))
        )

    @cached_property
    def end(self) -> Limit | None:
        """What ends its use first; None: nothing that the supply can bring about."""
        return next((limit for limit in self.limits if limit.ends and limit.pressure_kPa is not None), None)

    @property
    def usable_kPa(self) -> float:
        """Up to where it can be used."""
        end = self.end.pressure_kPa if self.end else None
        return self.vine.max_kPa if end is None else end

    @property
    def dead_zone_kPa(self) -> float:
        """The pressure at which it has bent by a twentieth of its greatest bend."""
        return float(np.interp(0.05 * self.angle_deg[-1], self.angle_deg, self.pressure_kPa))

    def at(self, values: Array, pressure_kPa: float) -> float:
        """One of the arrays at a pressure, interpolated."""
        return float(np.interp(pressure_kPa, self.pressure_kPa, values))


def bend(vine: BendingVine, pressure_kPa: ArrayLike | None = None) -> BendingCurve:
    """The vine at rest at rising gauge pressures, by default 0 to its supply's `max_kPa`.

    Raises `ValueError` when the pressures do not rise from 0.
    """
    kPa = (
        np.linspace(0.0, vine.max_kPa, POINTS + 1) if pressure_kPa is None else np.array(pressure_kPa, float)
    )
    if kPa.ndim != 1 or len(kPa) < 2 or kPa[0] != 0.0 or not np.all(np.diff(kPa) > 0.0):
        raise ValueError("the pressures must rise from 0")
    actuator, yielding = vine.actuator, vine.body.yielding
    under = kPa[1:]

    def rests(bulge: Array) -> NDArray[np.bool_]:
        state = actuator.state(under, bulge)
        asked = np.interp(state.contraction, yielding.contraction, yielding.force_N, left=-np.inf)
        return np.asarray(state.force_N <= asked)

    state = actuator.state(under, bulge_where(rests, under.shape))
    contraction = np.append(0.0, np.maximum(state.contraction, 0.0))
    curvature = np.interp(contraction, yielding.contraction, yielding.curvature_per_m)
    return BendingCurve(
        vine=vine,
        pressure_kPa=kPa,
        contraction=contraction,
        curvature_per_m=curvature,
        angle_deg=np.degrees(curvature * actuator.length_m),
        force_N=np.interp(contraction, yielding.contraction, yielding.force_N),
        volume_L=np.append(0.0, state.volume_L),
        film_N_per_mm=np.append(0.0, state.film_N_per_m / 1000.0),
        free_contraction=np.append(0.0, np.maximum(free(actuator, under).contraction, 0.0)),
    )


def _limits(found: BendingCurve) -> Sequence[Limit]:
    body, actuator, load = found.vine.body, found.vine.actuator, found.vine.tip_load_N
    length = actuator.length_m
    # In the end a soft film stretches faster than it shortens.
    stalled = found.angle_deg[1:] <= np.maximum.accumulate(found.angle_deg)[:-1]

    def met(name: LimitName, values: Array, beyond: float, reason: str, ends: bool = True) -> Limit:
        reached = bool(np.any(values >= beyond))
        kPa = _first(found.pressure_kPa, values, beyond) if reached else None
        return Limit(name, kPa, reason, ends)

    return (
        met(
            "wrinkling",
            found.force_N,
            body.wrinkling_N,
            f"the inner side wrinkles under a pull of {body.wrinkling_N:.3g} N; from here it bends easily",
            ends=False,
        ),
        met(
            "collapse",
            -found.tip_load_N,
            -load,
            f"the base gives way to {load:.3g} N across the tip; straight it bears "
            f"{float(body.tip_load_N(length)):.3g} N",
        )
        if load > 0.0
        else Limit("collapse", None, "the base gives way to a load only, and tip_load_N is 0", True),
        met("axial", found.force_N, body.axial_N, f"a pull of {body.axial_N:.3g} N crushes the body"),
        met(
            "contraction",
            np.where(stalled, 1.0, found.contraction[1:] / np.maximum(found.free_contraction[1:], 1e-9)),
            SATURATED,
            f"{100 * SATURATED:.0f} % of all that the actuator can shorten; more pressure brings little",
        ),
        met(
            "burst",
            found.film_N_per_mm,
            actuator.strength_N_per_mm,
            f"the film or a seam tears at {actuator.strength_N_per_mm:.3g} N/mm",
        ),
    )


def _first(kPa: Array, values: Array, beyond: float) -> float:
    """The pressure where values first reach a bound, between the points."""
    kPa = kPa[len(kPa) - len(values) :]
    i = int(np.argmax(values >= beyond))
    if i == 0:
        return float(kPa[0])
    share = (beyond - values[i - 1]) / (values[i] - values[i - 1])
    return float(kPa[i - 1] + share * (kPa[i] - kPa[i - 1]))
