"""Compares the paper's frequency responses with the baseline in closed loop, and with each cause.

Each cause is put into the plant, with the regulator that the paper describes. Its gains are compared with
those of TC4 and TC5 in dB. The paper does not state the regulator's PID, the valve drivers, tubes, the
outlet, or any phase. So a cause that comes nearer could explain the difference, but this does not prove that
it is there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import ceil, log, pi

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.identification.verdict import NONE
from flying_vines.physics.arrays import Array
from flying_vines.physics.effects import setup
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.setup import Setup
from flying_vines.physics.plant.simulator import TICK_S
from flying_vines.physics.plant.tubing import Tubing
from flying_vines.physics.rig import ControlVolume, Rig, Solenoid
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop
from flying_vines.studies.paper.bench import FIXED_SOURCE, PAPERS_TUNING
from flying_vines.studies.paper.compare import BAND, decibel, rms
from flying_vines.studies.paper.data import condition, curve, stated
from flying_vines.studies.paper.diagnosis.evidence import Linear, Noise, worth

TESTS = ("tc4", "tc5")
SUPPLY_KPA = {"tc4": 690.0, "tc5": 345.0}
"""Supplies (gauge); TC5's is from the paper's list of test conditions."""
OTHER_SUPPLY_KPA = {**SUPPLY_KPA, "tc5": 690.0}
"""TC5's is from the text below that list."""
BASE = Rig(cv=ControlVolume(1.0))
"""The default rig, for what the paper does not state of valves and outlet."""

SETTLE_S = 1.0
MEASURE_S = 1.5
CORNERS = 64
"""Corners of the polygon that approximates a cycle of the command."""
READINGS = 1000
"""Maximum readings in a cycle: a slow command does not need every tick."""
TUBE_L = 0.0126
"""Volume of a metre of 4 mm tube."""

DISCREPANCIES_DB = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
LENGTHS = (0.2, 0.7, 2.0)
"""Correlation lengths in the logarithm of frequency."""
SCALES = (0.001, 0.03, 0.1)
"""Standard deviations of the logarithm of a factor on all gains of a test."""
DB = 20.0 / log(10.0)


@dataclass(frozen=True)
class Suspect:
    """A possible difference of the bench, with one parameter."""

    name: str
    parameter: str
    values: tuple[float, ...]
    """Tested values, with equal prior probability."""
    made: Callable[[Rig, float], Setup] | None = None
    """None: the cause of that name."""

    def on(self, rig: Rig, value: float) -> Setup:
        """The bench with this difference."""
        return self.made(rig, value) if self.made else setup(rig, self.name, **{self.parameter: value})


def _tube(rig: Rig, flow_resistance_kPa_s_per_SL: float) -> Setup:
    return _with_tube(setup(rig), flow_resistance_kPa_s_per_SL)


def _with_tube(made: Setup, flow_resistance_kPa_s_per_SL: float) -> Setup:
    tubing = Tubing(TUBE_L, flow_resistance_kPa_s_per_SL)
    return replace(made, plant=Plant(made.plant.rig, replace(made.plant.effects, tubing=tubing)))


def _outlet(rig: Rig, scale: float) -> Setup:
    return setup(replace(rig, solenoid=Solenoid(scale * rig.solenoid.flow_resistance_kPa_s_per_SL)))


SUSPECTS = (
    Suspect("evp_restriction", "scale", (0.5, 0.6, 0.7, 0.85, 1.2)),
    Suspect("compressible_flow", "critical_pressure_ratio", (0.1, 0.3, 0.5)),
    Suspect("cv_heating", "time_constant_s", (0.03, 0.1, 0.3, 1.0, 3.0)),
    Suspect("dead_volume", "volume_L", (-0.2, -0.1, 0.1, 0.2)),
    Suspect("cv_leak", "flow_resistance_kPa_s_per_SL", (200.0, 1000.0, 5000.0)),
    Suspect("evp_dead_zone", "opening", (0.15, 0.3, 0.5)),
    Suspect("evp_hysteresis", "width", (0.05, 0.1, 0.2)),
    Suspect("evp_lag", "time_constant_s", (0.005, 0.015, 0.04)),
    Suspect("line_delay", "delay_s", (0.005, 0.015, 0.04)),
    Suspect("solenoid_slow_close", "delay_s", (0.01, 0.03, 0.08)),
    Suspect("cv_sensor_lag", "time_constant_s", (0.005, 0.015, 0.04)),
    Suspect("cv_sensor_gain", "gain", (0.95, 1.03, 1.06)),
    Suspect("venturi_stall", "supply_pressure_kPa", (200.0, 500.0)),
    Suspect("outlet", "resistance_scale", (0.4, 0.7, 1.5), _outlet),
    Suspect("tube", "flow_resistance_kPa_s_per_SL", (3.0, 6.0, 12.0, 25.0), _tube),
)
FLOOR = "gain_floor"
FLOORS = (0.1, 0.15, 0.2, 0.25)
"""Error of the evaluation, not of the rig: drift and offset in an FFT of few cycles; added in squares."""
WITH_TUBE = ("compressible_flow", "cv_heating")
AGAIN = ("evp_restriction", "cv_heating", "tube")
"""Also tested on TC5's other supply."""


@dataclass(frozen=True)
class Account:
    """The gains with one or two suspects, compared with the measured ones."""

    names: tuple[str, ...]
    best: dict[str, float]
    """The most likely tested value of each suspect."""
    minus_2_ln: float
    """−2 ln of the evidence, averaged over all values."""
    rms_dB: tuple[float, ...]
    """Distance of the best values from the measured gains for each test, over all points."""
    band_rms_dB: tuple[float, ...]
    """The same up to `BAND` drawn cut-offs."""
    gains: tuple[Array, ...]

    @property
    def label(self) -> str:
        return " + ".join(self.names) or NONE


@dataclass(frozen=True)
class Responses:
    """All tested accounts, the best first."""

    scatter_dB: float
    """Scatter of one gain, from the error bars of the off-the-shelf regulator."""
    accounts: tuple[Account, ...]
    """TC5 on 345 kPa."""
    other: tuple[Account, ...]
    """TC5 on 690 kPa."""

    def of(self, *names: str) -> Account:
        """The account with these suspects, with TC5 on 345 kPa."""
        return next(a for a in self.accounts if set(a.names) == set(names))

    def above(self, account: Account) -> float:
        """−2 ln of its evidence relative to the best on either supply."""
        return account.minus_2_ln - min(a.minus_2_ln for a in (*self.accounts, *self.other))


def account_for(
    progress: Callable[[str], None] = lambda step: None,
    suspects: Sequence[Suspect] = SUSPECTS,
    with_tube: Sequence[str] = WITH_TUBE,
    again: Sequence[str] = AGAIN,
) -> Responses:
    """Compare the suspects with the measured gains.

    Args:
        suspects: tested alone, with and without a floor; one of them must be the tube.
        with_tube: suspects that are also tested with a tube.
        again: suspects that are also tested on TC5's other supply.
    """
    by_name = {suspect.name: suspect for suspect in suspects}
    with threadpool_limits(1):
        trials = _Trials(SUPPLY_KPA)
        found = trials.explained((), {(): setup(BASE)})
        for suspect in suspects:
            progress(f"frequency response: {suspect.name}")
            found += trials.explained((suspect.name,), {(v,): suspect.on(BASE, v) for v in suspect.values})
        tube = by_name["tube"]
        for name in with_tube:
            progress(f"frequency response: {name} with a tube")
            both = product(by_name[name].values, tube.values)
            benches: dict[tuple[float, ...], Setup] = {}
            benches |= {(v, r): _with_tube(by_name[name].on(BASE, v), r) for v, r in both}
            found += trials.explained((name, tube.name), benches)
        progress("frequency response: the other supply")
        others = _Trials(OTHER_SUPPLY_KPA)
        other = others.explained((), {(): setup(BASE)})
        for suspect in (by_name[name] for name in again):
            other += others.explained((suspect.name,), {(v,): suspect.on(BASE, v) for v in suspect.values})
    return Responses(trials.scatter_dB, _ordered(found), _ordered(other))


def _ordered(accounts: list[Account]) -> tuple[Account, ...]:
    return tuple(sorted(accounts, key=lambda account: account.minus_2_ln))


def scatter_dB() -> float:
    """The median error bar of the off-the-shelf regulator at gains above −3 dB."""
    bars = []
    for number in (1, 2):
        regulator = curve(f"frequency_baseline{number}")
        assert regulator.std is not None
        follows = regulator.y > np.sqrt(0.5)
        bars.append(DB * regulator.std[follows] / regulator.y[follows])
    return float(np.median(np.concatenate(bars)))


class _Trials:
    """Compares benches with the measured gains, on given supplies."""

    def __init__(self, supply_kPa: Mapping[str, float]) -> None:
        self.scatter_dB = scatter_dB()
        self._supply_kPa = supply_kPa
        self._measured = [curve(f"frequency_measured_{test}") for test in TESTS]
        self._noise = Noise(self.scatter_dB, DISCREPANCIES_DB, LENGTHS, SCALES, from_start=False)

    def explained(self, names: tuple[str, ...], benches: Mapping[tuple[float, ...], Setup]) -> list[Account]:
        """The accounts without and with a floor; `benches` has one bench for each set of values."""
        plain = {
            values: [gains(bench, test, self._supply_kPa[test]) for test in TESTS]
            for values, bench in benches.items()
        }
        floored = {
            (*values, floor): [np.hypot(g, floor) for g in found]
            for (values, found), floor in product(plain.items(), FLOORS)
        }
        return [self._account(names, plain), self._account((*names, FLOOR), floored)]

    def _account(self, names: tuple[str, ...], simulated: Mapping[tuple[float, ...], list[Array]]) -> Account:
        heights = {values: self._minus_2_ln(found) for values, found in simulated.items()}
        best = min(heights, key=lambda values: heights[values])
        above = np.array(list(heights.values())) - heights[best]
        left = [decibel(g / m.y) for g, m in zip(simulated[best], self._measured, strict=True)]
        bands = [
            m.x <= BAND * stated()[f"{test}.cutoff_drawn"].value
            for test, m in zip(TESTS, self._measured, strict=True)
        ]
        return Account(
            names=names,
            best=dict(zip(names, best, strict=True)),
            minus_2_ln=heights[best] - 2.0 * float(np.log(np.mean(np.exp(-0.5 * above)))),
            rms_dB=tuple(rms(e) for e in left),
            band_rms_dB=tuple(rms(e[band]) for e, band in zip(left, bands, strict=True)),
            gains=tuple(simulated[best]),
        )

    def _minus_2_ln(self, simulated: list[Array]) -> float:
        left = [decibel(m.y / g) for g, m in zip(simulated, self._measured, strict=True)]
        nothing = np.zeros(0)
        model = Linear(
            series=tuple(np.log(m.x) for m in self._measured),
            scaled=tuple(np.full(len(m.x), DB) for m in self._measured),
            residual=np.concatenate(left),
            traces=np.zeros((sum(len(e) for e in left), 0)),
            away=nothing,
            spread=nothing,
        )
        return worth(self._noise, model).minus_2_ln


def gains(made: Setup, test: str, supply_kPa: float) -> Array:
    """Response over command at each measured frequency, in closed loop on a constant supply."""
    tested = condition(test)
    rig = made.plant.rig
    assert rig.cv is not None
    assert BASE.cv is not None
    added_L = rig.cv.volume_L - BASE.cv.volume_L
    rig = replace(rig, reservoir=FIXED_SOURCE, cv=ControlVolume(tested.cv_volume_L + added_L))
    made = replace(made, plant=Plant(rig, made.plant.effects))
    measured = curve(f"frequency_measured_{test}").x.tolist()
    found = {f: _gain(made, f, tested.swing_kPa, supply_kPa) for f in set(measured)}
    return np.array([found[f] for f in measured])


def _gain(made: Setup, frequency_Hz: float, peak_to_peak_kPa: float, supply_kPa: float) -> float:
    """The gain at one frequency, over whole cycles after settling; the command is a polygon."""
    settle = ceil(SETTLE_S * frequency_Hz) if frequency_Hz > 1.0 / SETTLE_S else 0
    cycles = settle + max(1, ceil(MEASURE_S * frequency_Hz))
    ticks = round(cycles / frequency_Hz / TICK_S)
    every = max(1, round(1.0 / frequency_Hz / TICK_S / READINGS))
    corners = min(CORNERS, round(1.0 / frequency_Hz / TICK_S / 2.0)) * cycles
    at_s = np.round(np.arange(corners + 1) * (ticks / corners)) * TICK_S
    half, omega = 0.5 * peak_to_peak_kPa, 2.0 * pi * frequency_Hz
    command = half - half * np.cos(omega * at_s)
    slopes = np.abs(np.diff(command)) / np.diff(at_s)
    rows = zip(at_s[:-1].tolist(), command[1:].tolist(), slopes.tolist(), strict=True)
    table = closed_loop(
        made.plant,
        [SetpointChange(*row) for row in rows],
        ticks * TICK_S,
        at_rest(made.plant, supply_kPa),
        tuning=PAPERS_TUNING,
        cv_sensor=made.cv_sensor,
        reservoir_sensor=made.reservoir_sensor,
        record_every=every,
    ).table[round(settle / frequency_Hz / TICK_S / every) :]
    wave = np.exp(-1j * omega * table["time_s"])
    response = wave @ (table["cv_reading_kPa"] - table["cv_reading_kPa"].mean())
    return float(abs(response) / (half * 0.5 * len(table)))
