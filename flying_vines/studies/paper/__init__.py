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

from flying_vines.studies.paper.bench import LIKELY, Bench
from flying_vines.studies.paper.compare import Curves, curves
from flying_vines.studies.paper.report import as_json
from flying_vines.studies.paper.rows import PaperComparison, PaperRow, comparison

__all__ = ["Bench", "Curves", "PaperComparison", "PaperRow", "as_json", "compare"]


def compare(bench: Bench | None = None, likely: Bench = LIKELY) -> PaperComparison:
    """Reproduce the paper on two benches (takes seconds). Notes and findings refer to the default benches.

    Args:
        bench: rig, effects, sensors and regulator; default: the nominal rig. Each test sets its volumes and
            pressures.
        likely: the bench of the high-fidelity plant.
    """
    return comparison(curves(bench, likely))
