"""The paper's curves, and the responses of the plants to the same tests, as arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from flying_vines.physics import paper
from flying_vines.physics.arrays import Array
from flying_vines.physics.baseline import Inputs
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.plant.compiled import replay
from flying_vines.physics.plant.flow import Iso6358
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.simulator import TICK_S
from flying_vines.physics.rig import Evp, Reservoir, Rig
from flying_vines.studies.paper.bench import LIKELY, Bench, Trace, follow_sine, gain, run
from flying_vines.studies.paper.data import Condition, PrintedCurve, condition, curve, stated

STEP_TEST_S = 2.5
"""Long enough for TC1 to TC3 to settle. The paper does not state the length of its time series."""

NEAR_KPA = 1.0
"""A step response has arrived once it is this near to its target, where the paper's on-off control ends."""

DISCHARGE_STEP_S = 0.05

SINE_VOLUME_L = 0.5
"""Assumption: the paper does not state the volume of Fig. 6."""

HIGH_RESISTANCE = "4L_highRv"
"""The series for which the paper closed the valve partly."""
HIGH_RESISTANCE_RATIO = 105.0188 / 80.6138
"""Resistance of this valve setting, relative to that of the other series; from the drawn curves."""

BAND = 3.0
"""The useful band of a frequency response ends at this multiple of the drawn cut-off."""


@dataclass(frozen=True)
class DischargeCurve:
    """One series of Fig. 3. Pressures kPa gauge, times s."""

    name: str
    label: str
    reservoir_volume_L: float
    measured: PrintedCurve
    model: PrintedCurve
    """The drawn curve of the paper."""
    time_constant_s: float
    """τ of the drawn model."""
    best_time_constant_s: float
    """τ of the exponential with the least squared error."""
    plant_time_s: Array
    plant_kPa: Array
    """The baseline plant with the R_v that follows from τ."""
    likely_kPa: Array
    """The high-fidelity plant, at the same times; it is not fitted to the measurement."""

    @property
    def flow_resistance_kPa_s_per_SL(self) -> float:
        """R_v that follows from τ."""
        return self.time_constant_s * ALPHA_KPA / self.reservoir_volume_L

    def exponential_kPa(self, time_s: Array, time_constant_s: float) -> Array:
        """Eq. 3 from the first measured pressure."""
        return np.asarray(paper.discharge_kPa(time_s, float(self.measured.y[0]), time_constant_s))

    def at_points(self, plants_kPa: Array) -> Array:
        """The pressures of a plant at the measured points."""
        return np.interp(self.measured.x, self.plant_time_s, plants_kPa)

    def nrmse_percent(self, time_constant_s: float) -> float:
        """Error of an exponential at the measured points, relative to P_r0."""
        return self._relative_percent(self.exponential_kPa(self.measured.x, time_constant_s))

    def plants_nrmse_percent(self, plants_kPa: Array) -> float:
        """The same error of a plant."""
        return self._relative_percent(self.at_points(plants_kPa))

    def _relative_percent(self, at_points_kPa: Array) -> float:
        return 100.0 * rms(self.measured.y - at_points_kPa) / float(self.measured.y[0])


@dataclass(frozen=True)
class StepResponse:
    """TC1, TC2 or TC3. Rates kPa/s."""

    condition: Condition
    model_rate_kPa_per_s: float
    """Eq. 4 with the R_v of the discharge at low R_v."""
    faster_kPa_per_s: float
    """The measured rate, if the paper's error means faster than the model."""
    slower_kPa_per_s: float
    """The measured rate, if the paper's error means slower than the model."""
    trace: Trace
    rate_kPa_per_s: float
    """Mean rate of the plant until the pressure has arrived, or to the end of the test."""
    rise_s: float
    """Time until the pressure has arrived; NaN if longer than `STEP_TEST_S`."""

    @property
    def overshoot_kPa(self) -> float:
        return max(0.0, float(self.trace["cv_reading_kPa"].max()) - self.condition.swing_kPa)


@dataclass(frozen=True)
class MeasuredGains:
    """The measured points of TC4 or TC5 (Fig. 5). Frequencies Hz."""

    condition: Condition
    measured: PrintedCurve
    cutoff_Hz: float
    """Drawn cut-off of the paper's model."""

    def rms_dB(self, gains: Array, cutoffs: float = math.inf) -> float:
        """Distance of gains to the measured ones, up to this multiple of the drawn cut-off."""
        band = self.measured.x <= cutoffs * self.cutoff_Hz
        return rms(decibel(gains / self.measured.y)[band])

    @property
    def peak_rate_kPa_per_s(self) -> float:
        """Greatest rate of a sine at the drawn cut-off, if A is peak to peak."""
        return paper.sine_peak_rate_kPa_per_s(self.cutoff_Hz, self.condition.swing_kPa / 2.0)


@dataclass(frozen=True)
class FrequencyResponse(MeasuredGains):
    """The plant's response to TC4 or TC5 on one supply; gains in the order of the measured points."""

    supply_kPa: float
    model_gain: Array
    """The paper's model."""
    plant_gain: Array
    """The plant in closed loop."""


@dataclass(frozen=True)
class SineSeries:
    """The response to 1.2 Hz and 34 kPa peak to peak (Fig. 6)."""

    supply_kPa: float
    trace: Trace

    @property
    def peak_to_peak_kPa(self) -> float:
        return float(np.ptp(self.trace["cv_reading_kPa"]))


@dataclass(frozen=True)
class CycleComparison:
    """Eq. 8 for the demonstration, and the plant with the same task."""

    reservoir_kPa: Array
    rigid: Array
    """Eq. 8 with the rate of a triangle."""
    rigid_sine: Array
    """Eq. 8 with the maximum rate of a sine."""
    pouch: Array
    """Eq. 8 scaled to the air of a bending pouch that is flat at first."""
    plant_kPa: Array
    """Reservoir pressures at which a cycle of the plant was simulated."""
    plant_cost_kPa: Array
    """Pressure loss of the reservoir in this cycle."""
    plant_cycles: Array
    """Cycles left from this pressure."""


@dataclass(frozen=True)
class Curves:
    """All compared curves."""

    discharges: tuple[DischargeCurve, ...]
    steps: tuple[StepResponse, ...]
    likely_steps: tuple[StepResponse, ...]
    """TC1 to TC3 on the high-fidelity plant."""
    vine_step: StepResponse
    """TC1 on the high-fidelity plant with the vine's predictive regulator."""
    frequencies: tuple[FrequencyResponse, ...]
    """TC4; TC5 on 345 kPa; TC5 on 690 kPa."""
    likely_frequencies: tuple[FrequencyResponse, ...]
    """On the high-fidelity plant."""
    baselines: tuple[PrintedCurve, PrintedCurve]
    sines: tuple[SineSeries, ...]
    """With a supply of 690 kPa, and of half of it."""
    likely_sines: tuple[SineSeries, ...]
    """On the high-fidelity plant."""
    rated_sines: tuple[SineSeries, ...]
    """With the EVP's rated flow instead of the R_v of the discharge."""
    low_supply_kPa: float
    """Supply for which the plant has the paper's peak to peak at "low P_r"."""
    cycles: CycleComparison


def curves(bench: Bench | None = None, likely: Bench = LIKELY) -> Curves:
    """Run every test of the paper on two benches: the baseline's nominal rig, and the high-fidelity plant."""
    bench = bench or Bench()
    discharges = (
        discharge(HIGH_RESISTANCE, "4 L, high R_v", 4.0, likely),
        discharge("4L_lowRv", "4 L, low R_v", 4.0, likely),
        discharge("2L_lowRv", "2 L, low R_v", 2.0, likely),
    )
    resistance = discharges[1].flow_resistance_kPa_s_per_SL
    fixed_kPa = stated()["tc5.fixed_supply"].value
    rated = replace(bench, rig=replace(bench.rig, evp=Evp(rated_resistance_kPa_s_per_SL())))
    vines = replace(likely, noise_seed=None, tuning={})

    # Noise at the top would look like an overshoot.
    quiet = replace(likely, noise_seed=None)

    def steps(on: Bench) -> tuple[StepResponse, ...]:
        return tuple(step_response(on, condition(name), resistance) for name in ("tc1", "tc2", "tc3"))

    def frequencies(on: Bench) -> tuple[FrequencyResponse, ...]:
        return (
            frequency_response(on, condition("tc4"), fixed_kPa),
            frequency_response(on, condition("tc5"), condition("tc5").reservoir_kPa),
            frequency_response(on, condition("tc5"), fixed_kPa),
        )

    def sines(on: Bench) -> tuple[SineSeries, ...]:
        return tuple(sine_series(on, supply) for supply in (fixed_kPa, fixed_kPa / 2.0))

    return Curves(
        discharges=discharges,
        steps=steps(bench),
        likely_steps=steps(quiet),
        vine_step=step_response(vines, condition("tc1"), resistance),
        frequencies=frequencies(bench),
        likely_frequencies=frequencies(likely),
        baselines=(curve("frequency_baseline1"), curve("frequency_baseline2")),
        sines=sines(bench),
        likely_sines=sines(likely),
        rated_sines=sines(rated),
        low_supply_kPa=supply_for(bench, stated()["sine.low_supply"].value),
        cycles=cycles(bench, resistance),
    )


def discharge(name: str, label: str, reservoir_volume_L: float, likely: Bench) -> DischargeCurve:
    """One series of Fig. 3 against Eq. 3, against the best exponential, and against both plants."""
    measured, model = curve(f"discharge_{name}_measured"), curve(f"discharge_{name}_model")
    initial_kPa = float(measured.y[0])
    tau_s = fit_time_constant_s(model.x, model.y)
    resistance = tau_s * ALPHA_KPA / reservoir_volume_L
    baseline = Plant(Rig(reservoir=Reservoir(reservoir_volume_L), cv=None, evp=Evp(resistance)))
    # The paper does not state how far the valve was closed: the ratio is from its curves.
    closed = HIGH_RESISTANCE_RATIO if name == HIGH_RESISTANCE else 1.0
    samples = 1 + math.ceil(float(measured.x[-1]) / DISCHARGE_STEP_S)
    return DischargeCurve(
        name=name,
        label=label,
        reservoir_volume_L=reservoir_volume_L,
        measured=measured,
        model=model,
        time_constant_s=tau_s,
        best_time_constant_s=nearest_time_constant_s(measured.x, measured.y),
        plant_time_s=DISCHARGE_STEP_S * np.arange(samples, dtype=np.float64),
        plant_kPa=plant_discharge(baseline, initial_kPa, samples),
        likely_kPa=plant_discharge(likely_plant(likely, reservoir_volume_L, closed), initial_kPa, samples),
    )


def fit_time_constant_s(time_s: Array, pressure_kPa: Array) -> float:
    """τ of an exponential through the first pressure, by least squares of the logarithm, s."""
    fall = np.log(pressure_kPa / pressure_kPa[0])
    return float(-(time_s @ time_s) / (time_s @ fall))


def nearest_time_constant_s(time_s: Array, pressure_kPa: Array) -> float:
    """τ of an exponential through the first pressure, by least squares of the pressure, s."""
    rate = 1.0 / fit_time_constant_s(time_s, pressure_kPa)
    for _ in range(50):
        model = pressure_kPa[0] * np.exp(-rate * time_s)
        slope = -time_s * model
        rate += float((slope @ (pressure_kPa - model)) / (slope @ slope))
    return 1.0 / rate


def plant_discharge(plant: Plant, initial_kPa: float, samples: int) -> Array:
    """Discharge of a plant to atmosphere through the open EVP, kPa gauge, every `DISCHARGE_STEP_S`."""
    ticks = round(DISCHARGE_STEP_S / TICK_S)
    wide_open = np.tile((1.0, 0.0, 0.0), (samples * ticks, 1))
    start = Inputs(1.0, 0.0, False)
    flown = replay(plant, wide_open, at_rest(plant, initial_kPa), initial=start, record_every=ticks)
    return np.asarray(flown.table["reservoir_kPa"])


def likely_plant(bench: Bench, volume_L: float, closed: float) -> Plant:
    """The high-fidelity plant of a discharge.

    Args:
        bench: gives the effects. Their wall is the wall of one 2 L bottle.
        volume_L: volume of all bottles.
        closed: resistance of the partly closed valve, divided by its rated resistance.
    """
    law, wall = bench.effects.evp_law, bench.effects.reservoir_wall
    if isinstance(law, Iso6358):
        law = replace(law, sonic_conductance_SL_per_s_kPa=law.sonic_conductance_SL_per_s_kPa / closed)
    if wall is not None:
        bottles = volume_L / 2.0
        wall = replace(
            wall,
            conductance_W_per_K=bottles * wall.conductance_W_per_K,
            capacity_J_per_K=bottles * wall.capacity_J_per_K,
            outer_conductance_W_per_K=bottles * wall.outer_conductance_W_per_K,
        )
    effects = replace(bench.effects, evp_law=law, reservoir_wall=wall)
    return Plant(Rig(reservoir=Reservoir(volume_L), cv=None), effects)


def rated_resistance_kPa_s_per_SL() -> float:
    """R_v of the EVP from its rated flow (Sec. III-A) at its maximum pressure."""
    return paper.flow_resistance_kPa_s_per_SL(
        stated()["reservoir.pressure"].value, stated()["evp.flow"].value
    )


def full_flow_SLPM(flow_resistance_kPa_s_per_SL: float) -> float:
    """Flow through this resistance from a full reservoir."""
    return 60.0 * paper.flow_SL_per_s(stated()["reservoir.pressure"].value, flow_resistance_kPa_s_per_SL)


def step_response(bench: Bench, test: Condition, flow_resistance_kPa_s_per_SL: float) -> StepResponse:
    """One step of Sec. V-B by Eq. 4 and by the plant, supplied by the reservoir."""
    volume_L, target_kPa = test.cv_volume_L, test.swing_kPa
    rate = paper.inflation_rate_kPa_per_s(test.reservoir_kPa, flow_resistance_kPa_s_per_SL, volume_L)
    error = stated()[f"{test.name}.rate_error"].value / 100.0
    trace = run(
        bench.with_cv(volume_L),
        lambda _: target_kPa,
        reservoir_kPa=test.reservoir_kPa,
        duration_s=STEP_TEST_S,
    )
    near = trace["cv_reading_kPa"] >= target_kPa - NEAR_KPA
    arrived = int(np.argmax(near)) if near.any() else -1
    return StepResponse(
        condition=test,
        model_rate_kPa_per_s=rate,
        faster_kPa_per_s=rate * (1.0 + error),
        slower_kPa_per_s=rate * (1.0 - error),
        trace=trace,
        rate_kPa_per_s=float(trace["cv_reading_kPa"][arrived] / trace["time_s"][arrived]),
        rise_s=float(trace["time_s"][arrived]) if near.any() else math.nan,
    )


def window_s(model_rise_s: float, speed_ratio: float, nrmse: float) -> float:
    """The time over which two ramps to the same target were compared, from their nRMSE, s.

    NaN if this would be less than the rise time of the slower ramp.

    Args:
        model_rise_s: rise time of the model's ramp.
        speed_ratio: speed of the other ramp over that of the model.
        nrmse: error relative to the target.
    """
    slow, fast = sorted((1.0, 1.0 / speed_ratio), reverse=True)
    # In units of the model's rise time: the error while both rise, and while only the slower one rises.
    both = (1.0 / fast - 1.0 / slow) ** 2 * fast**3 / 3.0
    one = (1.0 - fast / slow) ** 3 * slow / 3.0
    window = (both + one) / nrmse**2
    return model_rise_s * window if window >= slow else math.nan


def measured_gains(name: str) -> MeasuredGains:
    """The measured points of the test condition tc4 or tc5."""
    cutoff_Hz = stated()[f"{name}.cutoff_drawn"].value
    return MeasuredGains(condition(name), curve(f"frequency_measured_{name}"), cutoff_Hz)


def frequency_response(bench: Bench, test: Condition, supply_kPa: float) -> FrequencyResponse:
    """TC4 or TC5 by Eq. 6 and by the plant on a fixed supply; A is taken as peak to peak."""
    points = measured_gains(test.name)
    measured = points.measured
    model_gain = paper.frequency_gain(measured.x, points.cutoff_Hz)
    rig = bench.with_cv(test.cv_volume_L).with_fixed_source()
    # A frequency that was measured twice is simulated once.
    found = {f: plant_gain(rig, f, test.swing_kPa, supply_kPa) for f in np.unique(measured.x).tolist()}
    gains = np.array([found[f] for f in measured.x.tolist()])
    return FrequencyResponse(test, measured, points.cutoff_Hz, supply_kPa, model_gain, gains)


def plant_gain(bench: Bench, frequency_Hz: float, peak_to_peak_kPa: float, supply_kPa: float) -> float:
    """The plant's gain in closed loop at one frequency."""
    trace = follow_sine(
        bench, frequency_Hz=frequency_Hz, peak_to_peak_kPa=peak_to_peak_kPa, reservoir_kPa=supply_kPa
    )
    kept_s = len(trace) * TICK_S
    return gain(trace, round(kept_s * frequency_Hz))


def last_crossing_Hz(frequency_Hz: Array, gains: Array, level: float) -> float:
    """Frequency above which the gain stays below a level, Hz; linear in log-log. NaN if there is none.

    Args:
        frequency_Hz: in any order; gains at equal frequencies are averaged.
        gains: gain at each frequency.
        level: gain level.
    """
    x = np.unique(frequency_Hz)
    y = np.array([gains[frequency_Hz == f].mean() for f in x])
    above = np.flatnonzero(y > level)
    if len(above) == 0 or above[-1] == len(x) - 1:
        return math.nan
    i = above[-1]
    part = math.log(y[i] / level) / math.log(y[i] / y[i + 1])
    return float(x[i] * (x[i + 1] / x[i]) ** part)


def sine_series(bench: Bench, supply_kPa: float) -> SineSeries:
    """The plant's response to 1.2 Hz (Fig. 6); the paper states neither volume nor low supply."""
    numbers = stated()
    trace = follow_sine(
        bench.with_cv(SINE_VOLUME_L).with_fixed_source(),
        frequency_Hz=numbers["sine.frequency"].value,
        peak_to_peak_kPa=numbers["sine.command"].value,
        reservoir_kPa=supply_kPa,
    )
    return SineSeries(supply_kPa, trace)


def supply_for(bench: Bench, peak_to_peak_kPa: float) -> float:
    """The supply pressure at which the plant's response to 1.2 Hz has this peak to peak, kPa gauge."""
    low, high = 50.0, 690.0
    for _ in range(10):
        middle = 0.5 * (low + high)
        if sine_series(bench, middle).peak_to_peak_kPa < peak_to_peak_kPa:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def cycles(bench: Bench, flow_resistance_kPa_s_per_SL: float) -> CycleComparison:
    """Eq. 8 over reservoir pressure for the demonstration (Sec. VII), and the plant with the same task."""
    numbers = stated()
    volume_L, swing_kPa = numbers["cycles.cv_volume"].value, numbers["cycles.swing"].value
    frequency, full_kPa = numbers["cycles.frequency"].value, numbers["reservoir.pressure"].value
    reservoir = np.linspace(0.0, full_kPa, 139)

    def by_paper(rate_kPa_per_s: float) -> Array:
        left = paper.n_cycles(
            reservoir,
            reservoir_volume_L=numbers["reservoir.volume"].value,
            cv_volume_L=volume_L,
            swing_kPa=swing_kPa,
            rate_kPa_per_s=rate_kPa_per_s,
            flow_resistance_kPa_s_per_SL=flow_resistance_kPa_s_per_SL,
        )
        return np.maximum(left, 0.0)

    rigid = by_paper(paper.triangle_rate_kPa_per_s(frequency, swing_kPa))
    more_air = paper.pouch_fill_SL(swing_kPa, volume_L) / paper.rigid_fill_SL(swing_kPa, volume_L)
    plant_kPa = np.array([40.0, 55.0, 70.0, 85.0, 100.0, 130.0, 170.0, 250.0, 350.0, 450.0, 570.0, full_kPa])
    costs, reached = zip(
        *(plant_cycle(bench.with_cv(volume_L), p, swing_kPa, frequency) for p in plant_kPa), strict=True
    )
    cost_kPa, part = np.array(costs), np.array(reached)
    # A cycle that reaches less than 95 % of its swing does not count.
    per_kPa = np.where(part >= 0.95, 1.0 / cost_kPa, 0.0)
    left = np.concatenate(([0.0], np.cumsum(np.diff(plant_kPa) * 0.5 * (per_kPa[1:] + per_kPa[:-1]))))
    return CycleComparison(
        reservoir_kPa=reservoir,
        rigid=rigid,
        rigid_sine=by_paper(paper.sine_peak_rate_kPa_per_s(frequency, swing_kPa / 2.0)),
        pouch=rigid / more_air,
        plant_kPa=plant_kPa,
        plant_cost_kPa=cost_kPa,
        plant_cycles=left,
    )


def plant_cycle(
    bench: Bench, reservoir_kPa: float, swing_kPa: float, frequency_Hz: float
) -> tuple[float, float]:
    """Pressure loss of the reservoir in a triangle cycle, kPa, and the reached share of the swing."""
    period_s, counted = 1.0 / frequency_Hz, 3

    def triangle(t: float) -> float:
        return swing_kPa * (1.0 - abs(1.0 - 2.0 * (t / period_s % 1.0)))

    trace = run(bench, triangle, reservoir_kPa=reservoir_kPa, duration_s=counted * period_s)
    spent_kPa = float(trace["reservoir_kPa"][0] - trace["reservoir_kPa"][-1])
    return spent_kPa / counted, float(np.ptp(trace["cv_reading_kPa"])) / swing_kPa


def distance_dB(measured: PrintedCurve, frequency_Hz: Array, gains: Array) -> float:
    """Distance of gains from measured ones at other frequencies, dB rms; linear in log-log.

    Args:
        measured: Hz, gain.
        frequency_Hz: frequencies of the gains, in any order.
        gains: gain at each frequency.
    """
    order = np.argsort(frequency_Hz)
    at = np.interp(np.log(measured.x), np.log(frequency_Hz[order]), decibel(gains[order]))
    return rms(at - decibel(measured.y))


def decibel(ratio: Array) -> Array:
    """20 log10 of a ratio, dB."""
    return np.asarray(20.0 * np.log10(ratio))


def rms(values: Array) -> float:
    """Root of the mean square, in the unit of the values."""
    return float(np.sqrt(np.mean(np.square(values))))
