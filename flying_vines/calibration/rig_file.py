"""What was measured, as the rig file of a diagnosis: each number believed as well as it was measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from flying_vines.calibration.findings import Findings
from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.plant.true_rig import TrueRig, true_rig_text
from flying_vines.supply import nominal_rig

LEAST_TOLERANCE, MOST_TOLERANCE = 1.0, 10.0
"""Percent to which a number is believed, whatever its interval says."""
KEYS = {
    "reservoir_volume_L": "reservoir.volume_L",
    "cv_volume_L": "cv.volume_L",
    "evp_flow_resistance_kPa_s_per_SL": "evp.flow_resistance_kPa_s_per_SL",
    "dvp_flow_resistance_kPa_s_per_SL": "dvp.flow_resistance_kPa_s_per_SL",
}
"""Of a rig file, by the findings' names."""
NOISE = {"cv_noise_kPa": "cv_noise_std_kPa", "reservoir_noise_kPa": "reservoir_noise_std_kPa"}


def rig_text(numbers: PneumaticsConfig, findings: Findings) -> str:
    """The file's text; `numbers` are those of the profile with the measured ones in it."""
    rig = nominal_rig(numbers)
    noise = {}
    for name, key in NOISE.items():
        found = findings.get(name)
        if found is not None and found.value is not None:
            noise[key] = float(f"{found.value:.3g}")
    tolerances = dict(_tolerances(findings))
    return true_rig_text(
        TrueRig(replace(rig, sensors=replace(rig.sensors, **noise), tolerance_percent=tolerances))
    )


def _tolerances(findings: Findings) -> Iterator[tuple[str, float]]:
    for name, key in KEYS.items():
        found = findings.get(name)
        if found and found.value and found.low is not None and found.high is not None:
            percent = 50.0 * (found.high - found.low) / found.value
            yield key, round(min(max(percent, LEAST_TOLERANCE), MOST_TOLERANCE), 1)
