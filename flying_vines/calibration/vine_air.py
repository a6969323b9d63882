"""Volumes, pouch, leaks and Venturi, from one balance of the reservoir.

While the outlet is shut, the vine's pressure shows how much air is in it. A rise dP takes, in kPa of the
reservoir,

    dF = V_cv/V_r dP        V_cv = V (1 + k p_a + 2 k P)

if the vine's volume is V (1 + k P). p_a is ambient pressure. So the fit gives the effective volume V_cv (with
the tube, as a mean from 0 to the top pressure) and its growth with pressure. A pouch (the bending chamber of
the vine) takes air before its pressure rises: the first inflation fills it from flat, later inflations
replace the air that a vent let out. With a rigid vessel of known volume in place of the vine, the ratio
V_cv/V_r gives the reservoir's volume V_r.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from flying_vines.calibration.findings import (
    SD_95,
    Chart,
    Estimate,
    Findings,
    MeasuredQuantity,
    Series,
    configured,
)
from flying_vines.calibration.readings import Readings, noise_kPa, smooth
from flying_vines.calibration.reservoir_balance import Balance, binned, fit_balance
from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.arrays import Array
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.supply.rig_prior import Prior

SMOOTHED_S = 0.05
FLAT_KPA = 1.0
"""A vine below this is vented; a pouch above it is full."""
MIN_RISE_KPA = 2.0
"""An inflation that rises less may not have filled the pouch."""
MAX_COMPLIANCE_PER_KPA = 0.02
LEAK_OFFSET_KPA_PER_S = 0.05
"""Prior of the part of a leak that is not proportional to gauge pressure (sensor's zero, choked flow)."""
MIN_VENTURI_S = 0.15
VENTURI_OFFSET_KPA = 100.0
"""Prior of c in the Venturi's flow, which is proportional to P + c: choked flow is proportional to the
absolute pressure."""
NO_EFFECT_SD = 1e-9
"""Prior standard deviation that removes a parameter."""
GAIN_SD = 0.01
"""Relative standard deviation of the ratio of both sensors' gains."""
RESERVOIR_ZERO_SD_KPA = 8.0
"""Standard deviation of the zero of the reservoir's sensor, if it was not measured."""
VINE_LEAK_SD = 0.03
"""Relative standard deviation of the vine's leak: the regulator has an error, and the pressure at the valves
differs from that at the leak."""
MIN_LEAK_SDS = 3.0
"""A leak is reported if it is this many standard deviations above zero."""
TOO_LITTLE = "too few inflations to measure the vine's volume"
GIVEN_VOLUME_SD = 0.005
"""Relative standard deviation of a reservoir's volume that a person measured by weighing its water."""
VESSEL_SD = 0.01
"""Relative standard deviation of the vessel's volume."""


@dataclass(frozen=True)
class AirInputs:
    """The inputs of the balance. Measured zeros of the sensors are already subtracted."""

    pneumatics: PneumaticsConfig
    reservoir_L: Estimate
    top_kPa: float
    settling_s: float
    """Time after an inflation until the gas of the vine is at ambient temperature again."""
    ambient_kPa: float
    reservoir_zero_sd_kPa: float = RESERVOIR_ZERO_SD_KPA

    @property
    def relative_sd(self) -> float:
        """Relative standard deviation of air that is calculated from the fall of the reservoir's pressure."""
        return hypot(self.reservoir_L.sd / self.reservoir_L.value, GAIN_SD)

    def flow_sd(self, at_kPa: float) -> float:
        """Relative standard deviation of a flow that is proportional to the reservoir's pressure."""
        return hypot(self.relative_sd, self.reservoir_zero_sd_kPa / (at_kPa + self.ambient_kPa))

    def full_flow_ratio(self, at_kPa: float) -> float:
        """Choked flow from the full reservoir, relative to the flow from a reservoir at `at_kPa`."""
        return (self.pneumatics.full_kPa + self.ambient_kPa) / (at_kPa + self.ambient_kPa)


@dataclass(frozen=True)
class VineAir:
    """The fitted balance of the vine's air, in kPa of the reservoir."""

    known: AirInputs
    balance: Balance
    unseen: tuple[str, ...] = ()
    """Parameters (growth, refill) that the readings do not show."""

    def volume(self) -> Estimate:
        """Effective volume in litres, mean from 0 to the top pressure."""
        return self.balance.values["volume"].times(self.known.reservoir_L.value, self.known.relative_sd)

    @property
    def SL_per_kPa(self) -> float:
        """Air in one kPa of the reservoir."""
        return self.known.reservoir_L.value / ALPHA_KPA

    def air_SL(self, from_kPa: float, to_kPa: float) -> float:
        """Air that a rise of pressure takes, at ambient temperature."""
        values, top = self.balance.values, self.known.top_kPa
        mean = values["volume"].value + values["growth"].value * ((from_kPa + to_kPa) - top) / 2.0
        return mean * (to_kPa - from_kPa) * self.SL_per_kPa

    @property
    def leak_SL_per_s_kPa(self) -> float:
        return max(0.0, self.balance.values["vine_leak"].value) * self.SL_per_kPa


def fit_vine_air(readings: Readings, known: AirInputs) -> VineAir:
    """Fit the balance of a whole recording. Measured zeros of the sensors are already subtracted."""
    columns = _columns(readings, known.top_kPa)
    ratio = known.pneumatics.cv_volume_L / known.pneumatics.reservoir_volume_L
    venturi = ALPHA_KPA / known.reservoir_L.value / known.pneumatics.dvp_flow_resistance_kPa_s_per_SL
    priors = {
        "growth": Prior(0.0, 4.0 * MAX_COMPLIANCE_PER_KPA * ratio),
        "leak_offset": Prior(0.0, LEAK_OFFSET_KPA_PER_S),
        "venturi_offset": Prior(0.0, VENTURI_OFFSET_KPA * venturi),
    }
    # A column of zeros would make the equations singular.
    priors |= {name: Prior(0.0, 1.0) for name, column in columns.items() if not column.any()}
    noise = noise_kPa(readings.reservoir_kPa)
    moved = np.concatenate([[False], np.diff(readings.setpoint_kPa) > 1e-6]) | (readings.dvp > 0.0)
    last_s = np.maximum.accumulate(np.where(moved, readings.t_s, -np.inf))
    settled = readings.t_s - last_s > known.settling_s
    bins = binned(readings, columns, settled, noise)
    balance = fit_balance(bins, priors, known.reservoir_L.value, known.ambient_kPa)
    # A parameter without evidence is set to zero: it would only make the volume less certain.
    unseen = [name for name in ("growth", "refill") if balance.values[name].low <= 0.0]
    if unseen:
        priors |= {name: Prior(0.0, NO_EFFECT_SD) for name in unseen}
        balance = fit_balance(bins, priors, known.reservoir_L.value, known.ambient_kPa)
    return VineAir(known, balance, tuple(unseen))


def _columns(readings: Readings, top_kPa: float) -> dict[str, Array]:
    """The consumers of air: cumulative kPa of the reservoir per unit of their parameter."""
    n, dt_s = len(readings), np.diff(readings.t_s, prepend=readings.t_s[0])
    steps = {name: np.zeros(n) for name in ("volume", "growth", "pouch", "refill", "vine_leak")}
    inflated_before = False
    rows = max(1, round(SMOOTHED_S / readings.step_s))
    for shut in readings.stretches(~readings.solenoid & readings.regulating):
        opened = np.flatnonzero(readings.evp[shut] > 0.0)
        if not len(opened):
            # After a short vent the gas warms, so the pressure rises although no air flows in.
            continue
        before_kPa = float(np.mean(readings.cv_kPa[max(0, shut.start - rows) : shut.start + 1]))
        vented = before_kPa < FLAT_KPA
        if not vented:
            before_kPa = float(np.mean(readings.cv_kPa[shut][max(0, opened[0] - rows) : opened[0] + 1]))
        fill = slice(shut.start + (0 if vented else int(opened[0])), shut.stop)
        kPa = smooth(readings.cv_kPa[fill], rows)
        # The reading before any flow. Later readings contain the pressure drop of the tube.
        kPa[0] = before_kPa
        steps["volume"][fill] = np.diff(kPa, prepend=kPa[0])
        steps["growth"][fill] = 0.5 * np.diff(kPa * (kPa - top_kPa), prepend=kPa[0] * (kPa[0] - top_kPa))
        steps["vine_leak"][fill] = kPa * dt_s[fill]
        if vented and kPa.max() > MIN_RISE_KPA:
            filling = readings.evp[fill][: max(int(np.argmax(kPa > FLAT_KPA)), int(opened[0])) + 1]
            name = "refill" if inflated_before else "pouch"
            steps[name][fill.start : fill.start + len(filling)] = filling / filling.sum()
            inflated_before = True
    steps["reservoir_leak"] = np.maximum(readings.reservoir_kPa, 0.0) * dt_s
    steps["leak_offset"] = dt_s
    if np.any(readings.dvp > 0.0):
        steps["venturi"] = readings.dvp * np.maximum(readings.reservoir_kPa, 0.0) * dt_s
        steps["venturi_offset"] = readings.dvp * dt_s
    return {name: np.cumsum(step) for name, step in steps.items()}


# The reservoir's volume.


def reservoir_volume(known: PneumaticsConfig, given_L: float | None = None) -> MeasuredQuantity:
    """The reservoir's volume as the person gave it; otherwise the configuration's number is used."""
    found = configured("reservoir_volume_L", "reservoir's volume", "L", known)
    if given_L is not None:
        return found.measured(Estimate(given_L, GIVEN_VOLUME_SD * given_L), "as you gave it")
    return found.unknown("from the configuration; an error scales all volumes, and all resistances inversely")


def vessel_volume(vessel: VineAir, vessel_L: float) -> Findings:
    """The reservoir's volume, measured with a rigid vessel whose volume is known (with its hose)."""
    found = reservoir_volume(vessel.known.pneumatics)
    ratio = vessel.balance.values["volume"]
    if ratio.low <= 0.0:
        return Findings((found.unknown("the reservoir's pressure did not fall when the vessel was filled"),))
    value = vessel_L / ratio.value
    sd = value * hypot(ratio.sd / ratio.value, GAIN_SD, VESSEL_SD)
    return Findings((found.measured(Estimate(value, sd), f"with a vessel of {vessel_L:g} L"),))


# Findings.


def reservoir_leak(vine: VineAir) -> Findings:
    """Leak of the reservoir, at its mean pressure."""
    bins = vine.balance.bins
    at_kPa = float(np.mean(bins.reservoir_kPa))
    rate = vine.balance.weighted_sum({"reservoir_leak": at_kPa, "leak_offset": 1.0})
    speed = MeasuredQuantity("reservoir_leak_kPa_per_s", "reservoir's leak", "kPa/s")
    resistance = MeasuredQuantity(
        "reservoir_leak_kPa_s_per_SL", "reservoir's leak, as a resistance", "kPa·s/SL"
    )
    flow = rate.times(vine.SL_per_kPa, vine.known.flow_sd(at_kPa))
    findings = (
        speed.measured(rate, f"at {at_kPa:.0f} kPa", minimum=0.0),
        _resistance(resistance, at_kPa, flow),
    )
    read = bins.reservoir_kPa - vine.balance.cold_kPa
    unused_kPa = vine.balance.without(*bins.columns)
    chart = Chart(
        "reservoir",
        "The reservoir's pressure",
        "time, s",
        "reservoir, kPa",
        (
            Series("readings", "points", bins.t_s, bins.reservoir_kPa),
            Series("fitted", "line", bins.t_s, vine.balance.fitted_kPa),
            Series(
                "at ambient temperature",
                "line",
                bins.t_s,
                read - (unused_kPa - np.mean(unused_kPa)),
            ),
        ),
        f"leak {rate.value:.3f} kPa/s ({rate.low:.3f} … {rate.high:.3f})",
    )
    return Findings(findings, charts=(chart,))


def vine_leak(vine: VineAir) -> Findings:
    """Leak of the vine, from the air that a held pressure takes beyond the reservoir's own leak."""
    relative_sd = hypot(vine.known.relative_sd, VINE_LEAK_SD)
    per_kPa = vine.balance.values["vine_leak"].times(vine.SL_per_kPa, relative_sd)
    finding = MeasuredQuantity("vine_leak_kPa_s_per_SL", "vine's leak, as a resistance", "kPa·s/SL")
    return Findings((_resistance(finding, 1.0, per_kPa),))


def volumes(vine: VineAir) -> Findings:
    """Effective volume and compliance of the vine, and the air of its pouch."""
    known, values = vine.known, vine.balance.values
    litres = vine.volume()
    volume = configured("cv_volume_L", "vine's effective volume", "L", known.pneumatics)
    if litres.low > 0.0:
        found = [volume.measured(litres, f"mean of 0 to {known.top_kPa:g} kPa, with the tube")]
    else:
        found = [volume.unknown(TOO_LITTLE)]
    for name, what in (
        ("pouch", "the first inflation, from flat"),
        ("refill", "later inflations, from vented"),
    ):
        finding = MeasuredQuantity(f"{name}_air_SL", f"air of {what}", "SL")
        if name in vine.unseen:
            found.append(finding.unknown("none seen: the vented vine stays full"))
        elif vine.balance.bins.columns[name].any():
            air = values[name].times(vine.SL_per_kPa, known.relative_sd)
            found.append(finding.measured(air, "before its pressure rises", minimum=0.0))
        else:
            found.append(finding.unknown("there was no such inflation"))
    found.append(_compliance(vine))
    return Findings(tuple(found), charts=(_staircase(vine),))


def venturi(vine: VineAir, ran_s: float) -> MeasuredQuantity:
    """Resistance of the fully open supply valve, at the full reservoir's pressure."""
    p = vine.known.pneumatics
    finding = configured("dvp_flow_resistance_kPa_s_per_SL", "Venturi's supply valve", "kPa·s/SL", p)
    if ran_s < MIN_VENTURI_S:
        return finding.unknown("the Venturi hardly ran: this vine vents fast enough without it")
    bins = vine.balance.bins
    took = np.diff(bins.columns["venturi_offset"], prepend=0.0)
    at_kPa = float(np.sum(took * bins.reservoir_kPa) / np.sum(took))
    rate = vine.balance.weighted_sum({"venturi": at_kPa, "venturi_offset": 1.0})
    flow = rate.times(vine.SL_per_kPa * vine.known.full_flow_ratio(at_kPa), vine.known.flow_sd(at_kPa))
    return inverse(finding, p.full_kPa, flow, f"with the nozzle; measured at {at_kPa:.0f} kPa")


def inverse(finding: MeasuredQuantity, kPa: float, flow: Estimate, note: str) -> MeasuredQuantity:
    """The resistance kPa / flow, with its interval."""
    if flow.low <= 0.0:
        return finding.unknown("too little air flowed to measure it")
    value, low, high = kPa / flow.value, kPa / flow.high, kPa / flow.low
    return replace(finding, value=value, low=low, high=high, note=note)


def _resistance(finding: MeasuredQuantity, at_kPa: float, flow: Estimate) -> MeasuredQuantity:
    """The resistance of a leak, if there is one."""
    if flow.value <= MIN_LEAK_SDS * flow.sd:
        min_resistance = float(f"{at_kPa / max(flow.high, 1e-9):.2g}")
        return finding.unknown(f"none seen: more than {min_resistance:g} kPa·s/SL")
    return inverse(finding, at_kPa, flow, "")


def _compliance(vine: VineAir) -> MeasuredQuantity:
    """k of the vine's volume V (1 + k P)."""
    finding = MeasuredQuantity("cv_compliance_per_kPa", "vine's growth with pressure", "1/kPa")
    top, ambient = vine.known.top_kPa, vine.known.ambient_kPa
    growth, mean = vine.balance.values["growth"], vine.balance.values["volume"].value
    rigid = mean - growth.value * (top + ambient) / 2.0
    if "growth" in vine.unseen or rigid <= 0.0:
        return finding.unknown("none seen: its volume does not change with pressure")
    return finding.measured(growth.times(0.5 / rigid), "the effective volume contains it", minimum=0.0)


def _staircase(vine: VineAir) -> Chart:
    """The chart: air that the inflations took, over the vine's pressure."""
    known, bins = vine.known, vine.balance.bins
    others = [name for name in bins.columns if name not in ("volume", "growth", "pouch", "refill")]
    rest_kPa = vine.balance.without(*others)
    first: list[tuple[float, float]] = []
    later: list[tuple[float, float]] = []
    rests: list[float] = []
    base_kPa = float("nan")
    pouch, refill = bins.columns["pouch"], bins.columns["refill"]
    holding = np.diff(bins.columns["vine_leak"], prepend=0.0) > 0.0
    # Bins in which the pressure falls are left out: the vine did not hold their mean pressure.
    falls = np.diff(bins.cv_kPa) < -0.05 * bins.cv_kPa[:-1]
    holding &= ~(np.append(falls, False) | np.append(False, falls))
    for k in np.flatnonzero(bins.counts):
        if bins.cv_kPa[k] < FLAT_KPA:
            rests = [*rests[-24:], rest_kPa[k]]
            base_kPa = float(np.mean(rests))
        elif np.isfinite(base_kPa) and holding[k]:
            rests = []
            inflation = first if pouch[k] > 0.5 and refill[k] < 0.5 else later
            inflation.append((bins.cv_kPa[k], (base_kPa - rest_kPa[k]) * vine.SL_per_kPa))
    line = np.linspace(0.0, known.top_kPa, 50)
    air = np.array([vine.air_SL(0.0, float(kPa)) for kPa in line])
    pouch_SL, refill_SL = (vine.balance.values[name].value * vine.SL_per_kPa for name in ("pouch", "refill"))
    litres = vine.volume()
    fitted = air + (refill_SL if later else pouch_SL)
    half_width = SD_95 * litres.sd / ALPHA_KPA * line
    series = [
        Series(label, "points", *np.array(points).T)
        for label, points in (("first inflation", first), ("later inflations", later))
        if points
    ]
    series.append(Series("fitted", "line", line, fitted))
    if first and later:
        series.append(Series("fitted, from flat", "line", line, air + pouch_SL))
    series.append(Series("95 % of the slope", "band", line, fitted - half_width, fitted + half_width))
    return Chart(
        "levels",
        "Air against pressure",
        "vine, kPa",
        "air taken since vented, SL",
        tuple(series),
        f"{litres.value:.4g} L ({litres.low:.4g} … {litres.high:.4g})",
    )
