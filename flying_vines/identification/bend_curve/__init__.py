"""Fits a bend curve to measured pairs of pressure and angle, up and down. Needs numpy and scipy.

pairs = load_pairs(Path("pairs.csv"))
found = fit(pairs)
found.hysteresis_kPa, found.rms_deg, found.curve
print(found.table)                          for the configuration
"""

from flying_vines.identification.bend_curve.fit import BendCurveFit, fit
from flying_vines.identification.bend_curve.law import Law
from flying_vines.identification.bend_curve.pairs import Pairs, PairsError, load_pairs, parse_pairs
from flying_vines.identification.bend_curve.sequence import CurveEstimate

__all__ = ["BendCurveFit", "CurveEstimate", "Law", "Pairs", "PairsError", "fit", "load_pairs", "parse_pairs"]
