"""A soft gripper with two on-off valves at a compressed-air line, from a raw file to its causes.

The readings come from equations of this file, and not from the project's plant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from flying_vines.identification.case import read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.held_out import in_odd_stretch
from flying_vines.identification.importing.answers_file import Answers
from flying_vines.identification.importing.runs import propose, write_case

ATMOSPHERE_KPA = 101.325


@dataclass(frozen=True)
class Gripper:
    """ISO 6358 at both valves, gas that exchanges heat with the wall, a leak, valves that act late."""

    volume_L: float = 0.25
    supply_kPa: float = 150.0
    inlet_SL_per_s_kPa: float = 2.2e-3
    outlet_SL_per_s_kPa: float = 1.6e-3
    critical_pressure_ratio: float = 0.32
    heat_s: float = 0.5
    leak_kPa_s_per_SL: float = 9000.0
    late_s: float = 0.012

    def pressures_kPa(
        self, time_s: np.ndarray, valves: Callable[[float], tuple[bool, bool]], steps: int = 50
    ) -> list[float]:
        """Gauge pressures at these times; explicit Euler, `steps` from sample to sample."""
        p, theta, found = ATMOSPHERE_KPA, 1.0, []
        dt = float(time_s[1] - time_s[0]) / steps
        for t in time_s:
            found.append(p - ATMOSPHERE_KPA)
            for step in range(steps):
                inflates, vents = valves(float(t) + step * dt - self.late_s)
                supply = self.supply_kPa + ATMOSPHERE_KPA
                inflow = inflates * self.inlet_SL_per_s_kPa * supply * self._share(p / supply)
                out = vents * self.outlet_SL_per_s_kPa * p * self._share(ATMOSPHERE_KPA / p)
                out += (p - ATMOSPHERE_KPA) / self.leak_kPa_s_per_SL
                # Energy (γ = 1.4, air enters at ambient temperature) and mass of the gas.
                gain = 1.4 * ATMOSPHERE_KPA * (inflow - theta * out) / self.volume_L
                air = p * self.volume_L / theta + dt * ATMOSPHERE_KPA * (inflow - out)
                p += dt * (gain - p / theta * (theta - 1.0) / self.heat_s)
                theta = p * self.volume_L / air
        return found

    def _share(self, ratio: float) -> float:
        b = self.critical_pressure_ratio
        return 1.0 if ratio <= b else sqrt(max(0.0, 1.0 - ((ratio - b) / (1.0 - b)) ** 2))


def grip(t: float) -> tuple[bool, bool]:
    """Four cycles of 6 s with inflations of different lengths."""
    into = t % 6.0
    return 0.5 <= into < 0.5 + (0.35, 0.8, 1.6, 0.5)[int(t // 6.0) % 4], into > 3.6


@pytest.mark.long
def test_the_causes_of_a_gripper_are_found_in_its_raw_file(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 24.0, 0.01)
    noise = np.random.default_rng(5).normal(0.0, 0.25, len(time_s))
    readings = np.round((np.array(Gripper().pressures_kPa(time_s, grip)) + noise) / 0.6836) * 0.6836
    rows = [
        f"{1000 * t:.0f};{kPa / 6.894757:.3f};{grip(t)[0]:d};{grip(t)[1]:d}".replace(".", ",")
        for t, kPa in zip(time_s.tolist(), readings.tolist(), strict=True)
    ]
    file = tmp_path / "gripper.csv"
    file.write_text("\n".join(["Messung 3", "Zeit [ms];Druck [psi];Ventil ein;Ventil aus", *rows]))
    write_case([propose(file, Answers(), {"cv": 0.25})], tmp_path / "case")
    verdict = diagnose(read_case(tmp_path / "case"))
    named = {verdict.cause, *(other.cause for other in verdict.also)}
    # A hose of some volume has nearly the same effect as heat.
    assert {"pump_curve", "choked_outlet"} <= named and named & {"cv_heating", "hose"}, named
    assert named & {"cv_leak", "orifice_leak", "viscous_leak"}, named
    assert verdict.held_out.nrmse_after < 0.2 * verdict.held_out.nrmse_before


@pytest.mark.parametrize("cycles", [2, 3, 4, 5, 6])
def test_each_part_of_a_repeated_cycle_is_both_shown_and_held_out(cycles: int) -> None:
    time_s = np.linspace(0.0, 60.0, 2401)[:-1]
    part = (time_s / 60.0 * cycles % 1.0 * 20.0).astype(int)
    held_out = np.bincount(part, in_odd_stretch(time_s)) / np.bincount(part)
    assert np.all((held_out > 0.1) & (held_out < 0.9)), held_out
