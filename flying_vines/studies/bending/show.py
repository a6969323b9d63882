"""Prints the bend of a vine on a terminal, and converts it to plain data for JSON."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from flying_vines.studies.bending.actuator import burst_kPa
from flying_vines.studies.bending.equilibrium import BendingCurve, Limit

ROWS = 9
"""Rows of the table, evenly from 0 to the maximum supply pressure."""


def show(found: BendingCurve, console: Console) -> None:
    """Print the curve, the limits and the usable range."""
    vine, body = found.vine, found.vine.body
    console.print(Text(vine.name, style="bold"))
    console.print(
        f"{vine.actuator.length_m:.3g} m long, {body.diameter_mm:g} mm wide at {body.pressure_kPa:g} kPa; "
        f"wrinkles at {body.wrinkling_Nm:.3g} N m, folds at {body.collapse_Nm:.3g} N m"
    )
    console.print(_table(found))
    for limit in found.limits:
        console.print(Text(f"· {words(limit)}", style="" if limit.pressure_kPa is not None else "dim"))
    console.print(Text(verdict(found), style="yellow" if found.end else "green"))


def words(limit: Limit) -> str:
    """A limit in one line."""
    at = "not reached" if limit.pressure_kPa is None else f"from {limit.pressure_kPa:.1f} kPa"
    return f"{limit.name} {at}: {limit.reason}"


def verdict(found: BendingCurve) -> str:
    """The usable range of the vine, and what ends it."""
    deg = found.at(found.angle_deg, found.usable_kPa)
    why = found.end.name if found.end else "the maximum supply pressure"
    return (
        f"Bends by {deg:.0f}° at {found.usable_kPa:.1f} kPa, starting at {found.dead_zone_kPa:.1f} kPa; "
        f"limited by {why}."
    )


def _table(found: BendingCurve) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False)
    columns = (
        ("kPa", found.pressure_kPa, ".1f"),
        ("bend °", found.angle_deg, ".1f"),
        ("1/m", found.curvature_per_m, ".2f"),
        ("short %", 100.0 * found.contraction, ".1f"),
        ("pull N", found.force_N, ".1f"),
        ("tip x mm", 1000.0 * found.tip_m[:, 0], ".0f"),
        ("y mm", 1000.0 * found.tip_m[:, 1], ".0f"),
        ("volume L", found.volume_L, ".3f"),
        ("air SL", found.air_SL, ".3f"),
        ("bears N", found.tip_load_N, ".2f"),
    )
    for heading, _, _ in columns:
        table.add_column(heading, justify="right", no_wrap=True)
    for kPa in np.linspace(0.0, found.vine.max_kPa, ROWS):
        table.add_row(*(format(found.at(values, kPa), how) for _, values, how in columns))
    return table


def as_json(found: BendingCurve) -> dict[str, Any]:
    """Everything as plain lists, numbers and texts; units are in the keys."""
    body = found.vine.body
    return {
        "vine": msgspec.to_builtins(found.vine),
        "length_m": found.vine.actuator.length_m,
        "wrinkling_Nm": body.wrinkling_Nm,
        "collapse_Nm": body.collapse_Nm,
        "axial_N": body.axial_N,
        "burst_kPa": burst_kPa(found.vine.actuator),
        "dead_zone_kPa": found.dead_zone_kPa,
        "usable_kPa": found.usable_kPa,
        "end": found.end.name if found.end else None,
        "limits": [limit._asdict() for limit in found.limits],
        "pressure_kPa": found.pressure_kPa.tolist(),
        "angle_deg": found.angle_deg.tolist(),
        "curvature_per_m": found.curvature_per_m.tolist(),
        "contraction": found.contraction.tolist(),
        "force_N": found.force_N.tolist(),
        "tip_m": found.tip_m.tolist(),
        "volume_L": found.volume_L.tolist(),
        "air_SL": found.air_SL.tolist(),
        "tip_load_N": found.tip_load_N.tolist(),
    }
