"""Where the bottle's air went: volume of the vine, pouch, leaks and Venturi, all from one account.

While the outlet is shut, the vine's pressure tells its air. A rise dP takes, in kPa of the bottle,

    dF = V_cv/V_r dP        V_cv = V (1 + k p_a + 2 k P)  of a volume V (1 + k P)

so what is measured is the *volume as pressure feels it*, the tube's included, as a mean from 0 to the top;
and how much it grows with pressure. An inflation from vented takes as much again as a pouch has to be filled
before its pressure rises: the first one from flat, later ones from what venting left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from flying_vines.calibration.account import AccountPrior, Balance, binned, settle
from flying_vines.calibration.charts import Chart, Series
from flying_vines.calibration.estimate import SD_95, Estimate
from flying_vines.calibration.findings import MeasuredQuantity, Result
from flying_vines.calibration.readings import Readings
from flying_vines.calibration.zero import noise_kPa
from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.arrays import Array
from flying_vines.physics.constants import ALPHA_KPA

SMOOTHED_S = 0.05
FLAT_KPA = 1.0
"""A vine that has less is vented; a pouch that has more is full."""
RISEN_KPA = 2.0
SOFTEST_PER_KPA = 0.02
LEAK_OFFSET_KPA_PER_S = 0.05
"""By how much a leak may differ from what goes with the gauge reading: a sensor's zero, or choking."""
LEAST_VENTURI_S = 0.15
VENTURI_OFFSET_KPA = 100.0
"""As for a leak: what chokes goes with the absolute pressure."""
NOTHING = 1e-9
SENSORS = 0.01
"""To which both sensors' gains are known, as a ratio."""
RESERVOIR_ZERO_SD_KPA = 8.0
"""Of the bottle's sensor, where nobody has looked at it with an empty bottle."""
VINE_LEAK_SURE = 0.03
"""To which the pressure at the leak is known by that at the valves, and how the regulator holds it."""
TOO_LITTLE = "too few inflations to tell the vine's volume"
SEEN_SD = 3.0
"""So many standard deviations above none, and a leak is there."""


@dataclass(frozen=True)
class AirInputs:
    """What the account is read with. Pressures of the vine are without its zero."""

    pneumatics: PneumaticsConfig
    bottle: Estimate
    """Litres."""
    top_kPa: float
    settling_s: float
    """After which the gas of a vine that was inflated is at ambient temperature again."""
    ambient_kPa: float

    @property
    def sure(self) -> float:
        """Relative standard deviation of the air that the bottle's fall tells."""
        return hypot(self.bottle.sd / self.bottle.value, SENSORS)

    def supply_sure(self, at_kPa: float) -> float:
        """Of a flow that goes with the bottle's pressure."""
        return hypot(self.sure, RESERVOIR_ZERO_SD_KPA / (at_kPa + self.ambient_kPa))


@dataclass(frozen=True)
class VineAir:
    """Its air as pressure tells it, in kPa of the bottle."""

    known: AirInputs
    balance: Balance
    unseen: tuple[str, ...] = ()
    """Of growth and refill: what the readings show nothing of."""

    def volume(self) -> Estimate:
        """As pressure feels it, mean from 0 to the top, litres."""
        return self.balance.values["volume"].times(self.known.bottle.value, self.known.sure)

    def air_SL(self, from_kPa: float, to_kPa: float) -> float:
        """That a rise takes, at ambient temperature."""
        values, top = self.balance.values, self.known.top_kPa
        mean = values["volume"].value + values["growth"].value * ((from_kPa + to_kPa) - top) / 2.0
        return mean * (to_kPa - from_kPa) * self.known.bottle.value / ALPHA_KPA

    @property
    def leak_SL_per_s_kPa(self) -> float:
        return max(0.0, self.balance.values["vine_leak"].value) * self.known.bottle.value / ALPHA_KPA


def read_air(readings: Readings, known: AirInputs) -> VineAir:
    """The account of all that was recorded; pressures of the vine without its zero."""
    columns = _columns(readings, known.top_kPa)
    ratio = known.pneumatics.cv_volume_L / known.pneumatics.reservoir_volume_L
    venturi = ALPHA_KPA / known.bottle.value / known.pneumatics.dvp_flow_resistance_kPa_s_per_SL
    priors = {
        "growth": AccountPrior(0.0, 4.0 * SOFTEST_PER_KPA * ratio),
        "leak_offset": AccountPrior(0.0, LEAK_OFFSET_KPA_PER_S),
        "venturi_offset": AccountPrior(0.0, VENTURI_OFFSET_KPA * venturi),
    }
    # What never happened is not known, and holds nothing up.
    priors |= {name: AccountPrior(0.0, 1.0) for name, column in columns.items() if not column.any()}
    noise = noise_kPa(readings.reservoir_kPa)
    moved = np.concatenate([[False], np.diff(readings.setpoint_kPa) > 1e-6]) | (readings.dvp > 0.0)
    last_s = np.maximum.accumulate(np.where(moved, readings.t_s, -np.inf))
    settled = readings.t_s - last_s > known.settling_s
    bins = binned(readings, columns, settled, noise)
    balance = settle(bins, priors, known.bottle.value, known.ambient_kPa)
    # What was not seen is not there: else it would leave the volume less sure than the readings do.
    unseen = [name for name in ("growth", "refill") if balance.values[name].low <= 0.0]
    if unseen:
        priors |= {name: AccountPrior(0.0, NOTHING) for name in unseen}
        balance = settle(bins, priors, known.bottle.value, known.ambient_kPa)
    return VineAir(known, balance, tuple(unseen))


def _columns(readings: Readings, top_kPa: float) -> dict[str, Array]:
    """What took air, as the account has it: kPa of the bottle per unit, cumulative."""
    n, dt_s = len(readings), np.diff(readings.t_s, prepend=readings.t_s[0])
    steps = {name: np.zeros(n) for name in ("volume", "growth", "pouch", "refill", "vine_leak")}
    seen = False
    rows = max(1, round(SMOOTHED_S / readings.step_s))
    for shut in readings.stretches(~readings.solenoid & readings.regulating):
        told = np.flatnonzero(readings.evp[shut] > 0.0)
        if not len(told):
            # Gas that was let out a little warms again, and its pressure rises without any air.
            continue
        before_kPa = float(np.mean(readings.cv_kPa[max(0, shut.start - rows) : shut.start + 1]))
        vented = before_kPa < FLAT_KPA
        if not vented:
            before_kPa = float(np.mean(readings.cv_kPa[shut][max(0, told[0] - rows) : told[0] + 1]))
        fill = slice(shut.start + (0 if vented else int(told[0])), shut.stop)
        kPa = smooth(readings.cv_kPa[fill], rows)
        # Once air flows the tube's resistance is in the reading.
        kPa[0] = before_kPa
        steps["volume"][fill] = np.diff(kPa, prepend=kPa[0])
        steps["growth"][fill] = 0.5 * np.diff(kPa * (kPa - top_kPa), prepend=kPa[0] * (kPa[0] - top_kPa))
        steps["vine_leak"][fill] = kPa * dt_s[fill]
        if vented and kPa.max() > RISEN_KPA:
            opened = readings.evp[fill][: max(int(np.argmax(kPa > FLAT_KPA)), int(told[0])) + 1]
            name = "refill" if seen else "pouch"
            steps[name][fill.start : fill.start + len(opened)] = opened / opened.sum()
            seen = True
    steps["bottle_leak"] = np.maximum(readings.reservoir_kPa, 0.0) * dt_s
    steps["leak_offset"] = dt_s
    if np.any(readings.dvp > 0.0):
        steps["venturi"] = readings.dvp * np.maximum(readings.reservoir_kPa, 0.0) * dt_s
        steps["venturi_offset"] = readings.dvp * dt_s
    return {name: np.cumsum(step) for name, step in steps.items()}


def smooth(column: Array, rows: int) -> Array:
    """Means over so many neighbours, none from outside."""
    sums = np.concatenate([[0.0], np.cumsum(column)])
    at = np.arange(len(column))
    begin, end = np.maximum(at - rows // 2, 0), np.minimum(at + rows // 2 + 1, len(column))
    return np.asarray((sums[end] - sums[begin]) / (end - begin))


# Findings.


def bottle_leak(vine: VineAir) -> Result:
    """Of the bottle by itself, at its mean pressure."""
    bins = vine.balance.bins
    at_kPa = float(np.mean(bins.reservoir_kPa))
    rate = vine.balance.of({"bottle_leak": at_kPa, "leak_offset": 1.0})
    speed = MeasuredQuantity("bottle_leak_kPa_per_s", "bottle's leak", "kPa/s")
    resistance = MeasuredQuantity("bottle_leak_kPa_s_per_SL", "bottle's leak, as a resistance", "kPa·s/SL")
    known = vine.known
    flow = rate.times(known.bottle.value / ALPHA_KPA, known.supply_sure(at_kPa))
    findings = (
        speed.measured(rate, f"at {at_kPa:.0f} kPa", least=0.0),
        _resistance(resistance, at_kPa, flow),
    )
    read = bins.reservoir_kPa - vine.balance.cold_kPa
    kept = vine.balance.without(*bins.columns)
    chart = Chart(
        "bottle",
        "The bottle's account",
        "time, s",
        "bottle, kPa",
        (
            Series("read", "points", bins.t_s, bins.reservoir_kPa),
            Series("explained", "line", bins.t_s, vine.balance.fitted_kPa),
            Series("were it at ambient temperature", "line", bins.t_s, read - (kept - np.mean(kept))),
        ),
        f"leak {rate.value:.3f} kPa/s ({rate.low:.3f} … {rate.high:.3f})",
    )
    return Result(findings, charts=(chart,))


def vine_leak(vine: VineAir) -> Result:
    """Of the vine, by what holding it took beyond what the bottle loses anyway."""
    per_kPa = vine.balance.values["vine_leak"].times(
        vine.known.bottle.value / ALPHA_KPA, hypot(vine.known.sure, VINE_LEAK_SURE)
    )
    finding = MeasuredQuantity("vine_leak_kPa_s_per_SL", "vine's leak, as a resistance", "kPa·s/SL")
    return Result((_resistance(finding, 1.0, per_kPa),))


def volumes(vine: VineAir) -> Result:
    """Of the vine: its volume as pressure feels it, how soft it is, and what a pouch takes before."""
    known, values = vine.known, vine.balance.values
    litres = vine.volume()
    per_kPa = known.bottle.value / ALPHA_KPA
    volume = MeasuredQuantity(
        "cv_volume_L",
        "vine's volume, as pressure feels it",
        "L",
        believed=known.pneumatics.cv_volume_L,
        key="pneumatics.cv_volume_L",
    )
    if litres.low > 0.0:
        found = [volume.measured(litres, f"mean of 0 to {known.top_kPa:g} kPa, the tube's included")]
    else:
        found = [volume.unknown(TOO_LITTLE)]
    for name, what in (("pouch", "the first inflation, from flat"), ("refill", "a later one, from vented")):
        finding = MeasuredQuantity(f"{name}_air_SL", f"air of {what}", "SL")
        if name in vine.unseen:
            found.append(finding.unknown("none seen: venting leaves the vine full"))
        elif vine.balance.bins.columns[name].any():
            air = values[name].times(per_kPa, known.sure)
            found.append(finding.measured(air, "before its pressure rises", least=0.0))
        else:
            found.append(finding.unknown("there was none"))
    found.append(_softness(vine))
    return Result(tuple(found), charts=(_staircase(vine),))


def venturi(vine: VineAir, ran_s: float) -> MeasuredQuantity:
    """The Venturi's supply valve, told fully open, at the full bottle's pressure."""
    p = vine.known.pneumatics
    finding = MeasuredQuantity(
        "dvp_flow_resistance_kPa_s_per_SL",
        "Venturi's supply valve",
        "kPa·s/SL",
        believed=p.dvp_flow_resistance_kPa_s_per_SL,
        key="pneumatics.dvp_flow_resistance_kPa_s_per_SL",
    )
    if ran_s < LEAST_VENTURI_S:
        return finding.unknown("the Venturi hardly ran: this vine vents quickly enough by itself")
    bins = vine.balance.bins
    took = np.diff(bins.columns["venturi_offset"], prepend=0.0)
    at_kPa = float(np.sum(took * bins.reservoir_kPa) / np.sum(took))
    rate = vine.balance.of({"venturi": at_kPa, "venturi_offset": 1.0})
    flow = rate.times(
        vine.known.bottle.value / ALPHA_KPA * share_at_full(at_kPa, vine.known),
        vine.known.supply_sure(at_kPa),
    )
    return inverse(finding, p.full_kPa, flow, f"nozzle included; measured at {at_kPa:.0f} kPa")


def share_at_full(at_kPa: float, known: AirInputs) -> float:
    """By how much more a choked valve passes from a full bottle."""
    return (known.pneumatics.full_kPa + known.ambient_kPa) / (at_kPa + known.ambient_kPa)


def inverse(finding: MeasuredQuantity, kPa: float, flow: Estimate, note: str) -> MeasuredQuantity:
    """A resistance, of what flows at a pressure."""
    if flow.low <= 0.0:
        return finding.unknown("too little flowed to tell")
    value, low, high = kPa / flow.value, kPa / flow.high, kPa / flow.low
    return replace(finding, value=value, low=low, high=high, note=note)


def _resistance(finding: MeasuredQuantity, at_kPa: float, flow: Estimate) -> MeasuredQuantity:
    """Of a leak, which there need not be."""
    if flow.value <= SEEN_SD * flow.sd:
        most = max(flow.high, 1e-9)
        return finding.unknown(f"none seen: more than {float(f'{at_kPa / most:.2g}'):g} kPa·s/SL")
    return inverse(finding, at_kPa, flow, "")


def _softness(vine: VineAir) -> MeasuredQuantity:
    """k of V (1 + k P)."""
    finding = MeasuredQuantity("cv_compliance_per_kPa", "vine's growth with pressure", "1/kPa")
    top, ambient = vine.known.top_kPa, vine.known.ambient_kPa
    growth, mean = vine.balance.values["growth"], vine.balance.values["volume"].value
    rigid = mean - growth.value * (top + ambient) / 2.0
    if "growth" in vine.unseen or rigid <= 0.0:
        return finding.unknown("none seen: its volume is as good as the same at every pressure")
    return finding.measured(growth.times(0.5 / rigid), "its volume above is larger for it", least=0.0)


def _staircase(vine: VineAir) -> Chart:
    """Air that each inflation had taken by then against the pressure that it had made."""
    known, bins = vine.known, vine.balance.bins
    others = [name for name in bins.columns if name not in ("volume", "growth", "pouch", "refill")]
    kept_kPa = vine.balance.without(*others)
    x: list[float] = []
    y: list[float] = []
    pouch_x: list[float] = []
    pouch_y: list[float] = []
    rests: list[float] = []
    base_kPa = float("nan")
    first = vine.balance.bins.columns["pouch"]
    refilled = vine.balance.bins.columns["refill"]
    holding = np.diff(bins.columns["vine_leak"], prepend=0.0)
    for k in np.flatnonzero(bins.counts):
        if bins.cv_kPa[k] < FLAT_KPA:
            rests = [*rests[-24:], kept_kPa[k]]
            base_kPa = float(np.mean(rests))
        elif base_kPa == base_kPa and holding[k] > 0.0:
            rests = []
            air = (base_kPa - kept_kPa[k]) * known.bottle.value / ALPHA_KPA
            ahead = (pouch_x, pouch_y) if first[k] > 0.5 and refilled[k] < 0.5 else (x, y)
            ahead[0].append(bins.cv_kPa[k])
            ahead[1].append(air)
    line = np.linspace(0.0, known.top_kPa, 50)
    air = np.array([vine.air_SL(0.0, float(kPa)) for kPa in line])
    values = vine.balance.values
    pouch, refill = (values[name].value * known.bottle.value / ALPHA_KPA for name in ("pouch", "refill"))
    litres = vine.volume()
    series = [Series("first inflation", "points", np.array(pouch_x), np.array(pouch_y))] if pouch_x else []
    series.append(Series("later inflations", "points", np.array(x), np.array(y)))
    series.append(Series("fitted", "line", line, air + (refill if x else pouch)))
    if pouch_x and x:
        series.append(Series("fitted, from flat", "line", line, air + pouch))
    reach = SD_95 * litres.sd / ALPHA_KPA * line
    lifted = air + (refill if x else pouch)
    series.append(Series("95 % of the slope", "band", line, lifted - reach, lifted + reach))
    return Chart(
        "levels",
        "Air against pressure",
        "vine, kPa",
        "air taken since vented, SL",
        tuple(series),
        f"{litres.value:.4g} L ({litres.low:.4g} … {litres.high:.4g})",
    )
