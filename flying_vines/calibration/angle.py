"""Bend curve and hysteresis, from the angles that a person entered."""

from __future__ import annotations

import numpy as np

from flying_vines.calibration.findings import Chart, Estimate, MeasuredQuantity, Result, Series
from flying_vines.files.extras import lacks


def curve(pairs: tuple[tuple[float, float], ...]) -> Result:
    """Fit pairs (gauge kPa, degrees), in the order in which they were measured."""
    top = MeasuredQuantity("bend_top_deg", "bend at the highest pressure", "deg", key="vine.curve")
    width = MeasuredQuantity("hysteresis_kPa", "hysteresis of the bend", "kPa", key="vine.hysteresis_kPa")
    try:
        from flying_vines.identification.bend_curve import Pairs, PairsError, fit
        from flying_vines.identification.bend_curve.pairs import MIN_PAIRS
    except ImportError as error:
        why = f"{lacks(error)}; findings.json has the pairs for `vine fit`"
        return Result((top.unknown(why), width.unknown(why)))
    if len(pairs) < MIN_PAIRS:
        why = f"{len(pairs)} angles were entered; a curve needs at least {MIN_PAIRS}, up and down"
        return Result((top.unknown(why), width.unknown(why)))
    kPa, deg = np.array(pairs).T
    try:
        found = fit(Pairs(kPa, deg))
    except PairsError as error:
        return Result((top.unknown(str(error)), width.unknown(str(error))))
    last = found.curve[-1]
    sd = found.rms_deg / float(np.sqrt(len(pairs)))
    hysteresis = width.unknown("no angle was entered on the way down")
    if found.hysteresis_kPa is not None:
        h = found.hysteresis_kPa
        hysteresis = width.measured(Estimate.of_interval(h.value, h.low, h.high), minimum=0.0)
    line_kPa, line_deg = np.array(found.curve).T
    shift = found.written_hysteresis_kPa
    chart = Chart(
        "angle", "Angle against pressure", "vine, kPa", "bend, degrees",
        (
            Series("seen", "points", kPa, deg),
            Series("on the way up", "line", line_kPa, line_deg),
            Series("on the way down", "line", np.maximum(0.0, line_kPa - shift), line_deg),
        ),
    )  # fmt: skip
    return Result(
        (top.measured(Estimate(last[1], sd), f"at {last[0]:g} kPa"), hysteresis),
        remarks=found.notes,
        charts=(chart,),
        curve=found.curve,
        hysteresis_kPa=shift,
    )
