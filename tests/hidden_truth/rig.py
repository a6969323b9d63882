"""The numbers of a rig, true or nominal, and their form in `rig.toml`."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

from numpy.random import Generator

from hidden_truth.kernel import Physics

TOLERANCE_PERCENT = 1.0
"""Default tolerance of a number."""


@dataclass(frozen=True)
class Rig:
    """Numbers that may be off; `KEYS` has their names in `rig.toml`."""

    reservoir_L: float = 2.0
    cv_L: float | None = 0.5
    evp_kPa_s_per_SL: float = 2042.0
    dvp_kPa_s_per_SL: float = 618.0
    solenoid_kPa_s_per_SL: float = 70.0
    full_vacuum_kPa: float = 55.0
    rated_supply_kPa: float = 600.0


@dataclass(frozen=True)
class Noise:
    """Standard deviation of either reading."""

    cv_kPa: float = 0.15
    reservoir_kPa: float = 1.2


KEYS = {
    "reservoir_L": "reservoir.volume_L",
    "cv_L": "cv.volume_L",
    "evp_kPa_s_per_SL": "evp.flow_resistance_kPa_s_per_SL",
    "dvp_kPa_s_per_SL": "dvp.flow_resistance_kPa_s_per_SL",
    "solenoid_kPa_s_per_SL": "solenoid.flow_resistance_kPa_s_per_SL",
    "full_vacuum_kPa": "venturi.full_vacuum_kPa",
    "rated_supply_kPa": "venturi.rated_supply_kPa",
}
NUMBERS = tuple(KEYS)
WORN = NUMBERS[:-1]
"""The numbers that are wrong in a worn rig. The rated supply comes from the manufacturer and does not
change."""


def draw_rig(rng: Generator) -> tuple[Rig, Noise]:
    """Half of the rigs are like the public cases, the others are of any size that flies."""
    if rng.random() < 0.5:
        rig = Rig(reservoir_L=float(rng.choice([2.0, 4.0])), cv_L=float(rng.choice([0.1, 0.25, 0.5, 1.0])))
        return rig, Noise()

    def between(low: float, high: float, digits: int) -> float:
        return round(math.exp(rng.uniform(math.log(low), math.log(high))), digits)

    rig = Rig(
        reservoir_L=between(1.0, 6.0, 2),
        cv_L=between(0.05, 2.0, 3),
        evp_kPa_s_per_SL=between(1400.0, 3000.0, 0),
        dvp_kPa_s_per_SL=between(450.0, 900.0, 0),
        solenoid_kPa_s_per_SL=between(45.0, 110.0, 0),
        full_vacuum_kPa=between(40.0, 75.0, 0),
        rated_supply_kPa=between(450.0, 620.0, 0),
    )
    return rig, Noise(cv_kPa=between(0.05, 0.4, 2), reservoir_kPa=between(0.4, 2.5, 1))


def worn(rng: Generator, rig: Rig, percent: float) -> Rig:
    """The nominal numbers of a worn rig, rounded to five decimals."""
    off = {
        name: round(getattr(rig, name) * (1.0 + rng.uniform(-percent, percent) / 100.0), 5) for name in WORN
    }
    return replace(rig, **off)


def physics(rig: Rig) -> Physics:
    """The baseline with these numbers."""
    numbers = {name: getattr(rig, name) for name in NUMBERS}
    numbers["cv_L"] = math.inf if rig.cv_L is None else rig.cv_L
    return Physics(**numbers)


def rig_toml(assumed: Rig, stated: Noise, tolerance_percent: float) -> str:
    """The nominal rig for the project's own code."""
    lines = ["# the assumed rig: the simulation starts from these numbers"]
    table = ""
    for field in fields(assumed):
        value = getattr(assumed, field.name)
        if value is None:
            continue
        now, key = KEYS[field.name].split(".")
        if now != table:
            lines.append(f"[{now}]")
            table = now
        lines.append(f"{key} = {value!r}")
    lines.append("[sensors]")
    if assumed.cv_L is not None:
        lines.append(f"cv_noise_std_kPa = {stated.cv_kPa!r}")
    lines.append(f"reservoir_noise_std_kPa = {stated.reservoir_kPa!r}")
    if tolerance_percent != TOLERANCE_PERCENT:
        lines += ["", "[tolerance_percent]"]
        lines += [f'"{KEYS[name]}" = {tolerance_percent!r}' for name in WORN]
    return "\n".join(lines) + "\n"
