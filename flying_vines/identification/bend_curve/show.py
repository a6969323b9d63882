"""A bend-curve fit on a terminal, and as plain data."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from flying_vines.identification.bend_curve.fit import BendCurveFit
from flying_vines.identification.bend_curve.sequence import CurveEstimate


def show(found: BendCurveFit, console: Console) -> None:
    """Print the fit, and the table for the configuration."""
    pairs = found.pairs
    up = int(np.sum(pairs.rising))
    console.print(f"{len(pairs.rising)} pairs, {up} on the way up, {len(pairs.rising) - up} on the way down")
    table = Table(box=None, padding=(0, 1), pad_edge=False)
    for heading in ("quantity", "unit", "value", "95 % interval"):
        table.add_column(heading, justify="right" if heading in ("value", "95 % interval") else "left")
    for what, unit, estimate in _rows(found):
        if estimate is None:
            table.add_row(what, unit, "–", "not known")
        else:
            table.add_row(what, unit, f"{estimate.value:.4g}", f"{estimate.low:.4g} … {estimate.high:.4g}")
    table.add_row(
        "residual, rms", "°", f"{found.rms_deg:.3g}", "" if found.follows_law else "of a free curve"
    )
    console.print(table)
    for note in found.notes:
        console.print(Text(f"· {note}", style="yellow"))
    console.print("\nFor the configuration:\n", style="bold")
    console.print(found.table, end="", markup=False, highlight=False, soft_wrap=True)


def _rows(found: BendCurveFit) -> Iterator[tuple[str, str, CurveEstimate | None]]:
    yield "maximum bend θ_max", "°", found.bend_max_deg
    yield "dead zone P_d", "kPa", found.dead_kPa
    yield "scale P_s", "kPa", found.scale_kPa
    yield "hysteresis h", "kPa", found.hysteresis_kPa


def as_json(found: BendCurveFit) -> dict[str, Any]:
    """Everything as plain lists, numbers and texts."""

    def plain(estimate: CurveEstimate | None) -> dict[str, float] | None:
        return None if estimate is None else estimate._asdict()

    return {
        "pairs": len(found.pairs.rising),
        "pairs_up": int(np.sum(found.pairs.rising)),
        "bend_max_deg": plain(found.bend_max_deg),
        "dead_kPa": plain(found.dead_kPa),
        "scale_kPa": plain(found.scale_kPa),
        "hysteresis_kPa": plain(found.hysteresis_kPa),
        "law_rms_deg": found.law_rms_deg,
        "follows_law": found.follows_law,
        "rms_deg": found.rms_deg,
        "vine": {
            "curve": [list(pair) for pair in found.curve],
            "hysteresis_kPa": found.written_hysteresis_kPa,
        },
        "notes": list(found.notes),
    }
