"""Reproduces the paper "phloSAR": compares every number and curve of the paper with our number or curve.

    comparison = compare()
    comparison.rows         the table
    comparison.curves       the arrays behind it
    as_json(comparison)     both, for other programs
    figures.draw(comparison.curves, folder)     the pictures (needs matplotlib)

"Ours" is calculated by the paper's equations or from its printed data, or simulated. The simulated plants are
the baseline, and the high-fidelity plant with the probable effects of a real rig. In closed loop they have
the firmware's regulator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flying_vines.studies.paper.bench import LIKELY, Bench
from flying_vines.studies.paper.compare import Curves, curves
from flying_vines.studies.paper.findings import findings
from flying_vines.studies.paper.rows import PaperRow, table

__all__ = ["Bench", "Curves", "PaperComparison", "PaperRow", "as_json", "compare"]


@dataclass(frozen=True)
class PaperComparison:
    """The table, and the arrays behind it."""

    rows: tuple[PaperRow, ...]
    findings: tuple[str, ...]
    """Contradictions within the paper."""
    curves: Curves


def compare(bench: Bench | None = None, likely: Bench = LIKELY) -> PaperComparison:
    """Reproduce the paper on two benches (takes seconds). Notes and findings refer to the default benches.

    Args:
        bench: rig, effects, sensors and regulator; default: the nominal rig. Each test sets its volumes and
            pressures.
        likely: the bench of the high-fidelity plant.
    """
    found = curves(bench, likely)
    rows = table(found)
    return PaperComparison(rows, findings(rows), found)


def as_json(comparison: PaperComparison) -> dict[str, Any]:
    """The comparison as plain lists, numbers and texts; the keys are described in docs/paper.md."""
    c = comparison.curves
    return {
        "rows": [
            {
                "key": row.key,
                "quantity": row.quantity,
                "unit": row.unit,
                "paper": row.paper,
                "paper_to": row.paper_to,
                "bound": row.bound,
                "ours": row.ours,
                "relative_difference": row.relative_difference,
                "by": row.by,
                "verdict": row.verdict,
                "place": row.place,
                "note": row.note,
            }
            for row in comparison.rows
        ],
        "findings": list(comparison.findings),
        "discharge": [
            {
                "name": d.name,
                "reservoir_volume_L": d.reservoir_volume_L,
                "time_s": _plain(d.measured.x),
                "measured_kPa": _plain(d.measured.y),
                "time_constant_s": d.time_constant_s,
                "best_time_constant_s": d.best_time_constant_s,
                "flow_resistance_kPa_s_per_SL": d.flow_resistance_kPa_s_per_SL,
                "plant_kPa": _plain(np.interp(d.measured.x, d.plant_time_s, d.plant_kPa)),
                "likely_kPa": _plain(np.interp(d.measured.x, d.plant_time_s, d.likely_kPa)),
            }
            for d in c.discharges
        ],
        "inflation": [
            {
                "name": s.condition.name,
                "swing_kPa": s.condition.swing_kPa,
                "cv_volume_L": s.condition.cv_volume_L,
                "reservoir_kPa": s.condition.reservoir_kPa,
                "time_s": _plain(s.trace.time_s[::20]),
                "plant_kPa": _plain(s.trace.cv_kPa[::20]),
                "likely_kPa": _plain(likely.trace.cv_kPa[::20]),
                "plant_rate_kPa_per_s": s.rate_kPa_per_s,
                "likely_rate_kPa_per_s": likely.rate_kPa_per_s,
                "model_rate_kPa_per_s": s.model_rate_kPa_per_s,
            }
            for s, likely in zip(c.steps, c.likely_steps, strict=True)
        ],
        "frequency": [
            {
                "name": f.condition.name,
                "supply_kPa": f.supply_kPa,
                "frequency_Hz": _plain(f.measured.x),
                "measured_gain": _plain(f.measured.y),
                "model_gain": _plain(f.model_gain),
                "plant_gain": _plain(f.plant_gain),
                "likely_gain": _plain(likely.plant_gain),
            }
            for f, likely in zip(c.frequencies, c.likely_frequencies, strict=True)
        ],
        "sine": [
            {
                "supply_kPa": s.supply_kPa,
                "cv_volume_L": s.cv_volume_L,
                "time_s": _plain((s.trace.time_s - s.trace.time_s[0])[::10]),
                "command_kPa": _plain(s.trace.command_kPa[::10]),
                "plant_kPa": _plain(s.trace.cv_kPa[::10]),
                "likely_kPa": _plain(likely.trace.cv_kPa[::10]),
            }
            for s, likely in zip(c.sines, c.likely_sines, strict=True)
        ],
        "cycles": {
            "reservoir_kPa": _plain(c.cycles.reservoir_kPa),
            "rigid": _plain(c.cycles.rigid),
            "rigid_sine": _plain(c.cycles.rigid_sine),
            "pouch": _plain(c.cycles.pouch),
            "plant_reservoir_kPa": _plain(c.cycles.plant_kPa),
            "plant_cost_kPa": _plain(c.cycles.plant_cost_kPa),
            "plant": _plain(c.cycles.plant_cycles),
        },
    }


def _plain(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{value:.7g}") for value in values]
