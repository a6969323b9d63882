"""A vine's bend over its actuator's pressure: the balance of the actuator's pull and the body's resistance.

The pull of the actuator falls with its contraction, and the body needs more pull for more bend. So each
pressure has one bend. The bend rises with the pressure, until a soft film stretches faster than the actuator
shortens. Gravity is left out: it matters little for a light vine (Kübler et al. 2023).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.studies.bending.actuator import bulge_where, free
from flying_vines.studies.bending.description import BendingVine
from flying_vines.vine.shape import tip

SATURATED = 0.95
"""Share of the free contraction from which more pressure has little effect."""
POINTS = 240

LimitName = Literal["wrinkling", "collapse", "contraction", "burst"]


class Limit(NamedTuple):
    """A limit that the vine may reach as the pressure rises."""

    name: LimitName
    pressure_kPa: float | None
    """Actuator pressure at which it is reached, gauge; None if the supply does not reach it."""
    reason: str
    ends: bool
    """True if it ends the usable range. Wrinkling does not: every vine wrinkles as it bends."""


@dataclass(frozen=True)
class BendingCurve:
    """A vine over rising actuator pressures (kPa gauge); each array has a value for each pressure."""

    vine: BendingVine
    pressure_kPa: Array
    contraction: Array
    """Contraction of the actuator, as a share of its length."""
    curvature_per_m: Array
    angle_deg: Array
    """Angle of the tip against the base."""
    force_N: Array
    """The actuator's pull."""
    volume_L: Array
    """Volume of the actuator, which is flat without pressure."""
    film_N_per_mm: Array
    """Maximum tension in the actuator's film."""
    free_contraction: Array
    """Contraction of the actuator without load."""

    @cached_property
    def air_SL(self) -> Array:
        """The air in the actuator, standard litres: V (P_a + P)/α, isothermal. The flat actuator has none."""
        return self.volume_L * (self.vine.ambient_kPa + self.pressure_kPa) / ALPHA_KPA

    @cached_property
    def length_m(self) -> Array:
        """Length of the axis, which is shorter than the taut outer side."""
        body, length = self.vine.body, self.vine.actuator.length_m
        return length * (1.0 - self.contraction) + np.radians(self.angle_deg) * body.lever_m

    @cached_property
    def tip_m(self) -> Array:
        """x (sideways) and y (along the base) of the tip, a row for each pressure."""
        pairs = zip(self.angle_deg.tolist(), self.length_m.tolist(), strict=True)
        return np.array([tip(angle, length)[:2] for angle, length in pairs])

    @cached_property
    def tip_load_N(self) -> Array:
        """The load across the tip that folds the bent vine at its base, in the worst direction.

        This load is conservative: the actuator's pull is constant here, but in reality the pull falls as the
        vine gives way.
        """
        return self.vine.body.tip_load_N(self.vine.actuator.length_m, self.force_N)

    @cached_property
    def limits(self) -> tuple[Limit, ...]:
        """All limits, sorted by pressure; those that are not reached come last."""
        return tuple(
            sorted(_limits(self), key=lambda limit: (limit.pressure_kPa is None, limit.pressure_kPa))
        )

    @cached_property
    def end(self) -> Limit | None:
        """The first limit that ends the usable range; None if the supply reaches none."""
        return next((limit for limit in self.limits if limit.ends and limit.pressure_kPa is not None), None)

    @property
    def usable_kPa(self) -> float:
        """End of the usable range."""
        end = self.end.pressure_kPa if self.end else None
        return self.vine.max_kPa if end is None else end

    @property
    def dead_zone_kPa(self) -> float:
        """The pressure at 5 % of the maximum bend."""
        # The bend of a soft film may fall again.
        bent = np.maximum.accumulate(self.angle_deg)
        return float(np.interp(0.05 * bent[-1], bent, self.pressure_kPa))

    def at(self, values: Array, pressure_kPa: float) -> float:
        """One of the arrays at a pressure, interpolated."""
        return float(np.interp(pressure_kPa, self.pressure_kPa, values))


def bend(vine: BendingVine, pressure_kPa: ArrayLike | None = None) -> BendingCurve:
    """The vine at rest at rising gauge pressures; default: 0 to `max_kPa` of its supply.

    Raises `ValueError` if the pressures do not rise from 0.
    """
    kPa = (
        np.linspace(0.0, vine.max_kPa, POINTS + 1) if pressure_kPa is None else np.array(pressure_kPa, float)
    )
    if kPa.ndim != 1 or len(kPa) < 2 or kPa[0] != 0.0 or not np.all(np.diff(kPa) > 0.0):
        raise ValueError("the pressures must rise from 0")
    actuator, yielding = vine.actuator, vine.body.yielding
    under = kPa[1:]

    def rests(bulge: Array) -> BoolArray:
        state = actuator.state(under, bulge)
        needed = np.interp(state.contraction, yielding.contraction, yielding.force_N, left=-np.inf)
        return np.asarray(state.force_N <= needed)

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
    # At high pressure a soft film stretches faster than the actuator shortens.
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
            f"the base folds under {load:.3g} N across the tip; a straight vine bears "
            f"{float(body.tip_load_N(length)):.3g} N",
        )
        if load > 0.0
        else Limit("collapse", None, "the base folds only under a load, and tip_load_N is 0", True),
        met(
            "contraction",
            np.where(stalled, 1.0, found.contraction[1:] / np.maximum(found.free_contraction[1:], 1e-9)),
            SATURATED,
            f"{100 * SATURATED:.0f} % of the free contraction; more pressure has little effect",
        ),
        met(
            "burst",
            found.film_N_per_mm,
            actuator.strength_N_per_mm,
            f"the film or a seam tears at {actuator.strength_N_per_mm:.3g} N/mm",
        ),
    )


def _first(kPa: Array, values: Array, beyond: float) -> float:
    """The pressure at which values first reach a bound, interpolated."""
    kPa = kPa[len(kPa) - len(values) :]
    i = int(np.argmax(values >= beyond))
    if i == 0:
        return float(kPa[0])
    share = (beyond - values[i - 1]) / (values[i] - values[i - 1])
    return float(kPa[i - 1] + share * (kPa[i] - kPa[i - 1]))
