"""The bottle's volume, from what a vessel of known volume takes in place of the vine: V_r = V / (V/V_r)."""

from __future__ import annotations

from math import hypot

from flying_vines.calibration.air import SENSORS, VineAir
from flying_vines.calibration.estimate import Estimate
from flying_vines.calibration.findings import MeasuredQuantity, Result

KEY = "pneumatics.reservoir_volume_L"
VESSEL_SURE = 0.01
"""To which the vessel's volume is known."""


def finding(believed_L: float) -> MeasuredQuantity:
    return MeasuredQuantity("reservoir_volume_L", "bottle's volume", "L", believed=believed_L, key=KEY)


def given(bottle_L: float, believed_L: float) -> MeasuredQuantity:
    """As a person weighed it."""
    return finding(believed_L).measured(Estimate(bottle_L, 0.005 * bottle_L), "as you gave it")


def believed(bottle_L: float) -> MeasuredQuantity:
    """Nobody knows more than the profile."""
    return finding(bottle_L).unknown(
        "from the profile: pressures tell ratios of volumes; all volumes go with it, resistances against it"
    )


def bottle_volume(vessel: VineAir, vessel_L: float, believed_L: float) -> Result:
    """Of a rigid vessel with its hose."""
    ratio = vessel.balance.values["volume"]
    if ratio.low <= 0.0:
        return Result(
            (finding(believed_L).unknown("the bottle's reading shows no air that the vessel took"),)
        )
    value = vessel_L / ratio.value
    sd = value * hypot(ratio.sd / ratio.value, SENSORS, VESSEL_SURE)
    return Result((finding(believed_L).measured(Estimate(value, sd), f"with a vessel of {vessel_L:g} L"),))
