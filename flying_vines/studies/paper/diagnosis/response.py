"""Compares the paper's frequency responses with the baseline in closed loop, and with each cause.

The plant is simulated with each cause, and with the regulator that the paper describes. The resulting gains
are compared with the measured gains of TC4 and TC5 in dB. Causes are ranked on unseen data, as in
`identification`: each test is also predicted with the value that is best for the other test. The search of
`identification` cannot be used, because it needs recordings over time.

The paper does not state the regulator's PID, the valve drivers, tubes, the outlet, or any phase. So a cause
that reduces the difference is a possible explanation, not a proven one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import ceil, inf, pi

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.identification.search import Progress, silent
from flying_vines.identification.verdict import NONE
from flying_vines.physics.arrays import Array
from flying_vines.physics.effects import setup
from flying_vines.physics.plant.plant import Plant, Setup, at_rest
from flying_vines.physics.plant.simulator import TICK_S
from flying_vines.physics.rig import ControlVolume, Hose, Rig, Solenoid
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop
from flying_vines.studies.paper.bench import FIXED_SOURCE, PAPERS_TUNING
from flying_vines.studies.paper.compare import BAND, measured_gains, rms
from flying_vines.studies.paper.data import condition, curve, stated

TESTS = ("tc4", "tc5")
_FIXED_KPA = stated()["tc5.fixed_supply"].value
SUPPLY_KPA = {"tc4": _FIXED_KPA, "tc5": condition("tc5").reservoir_kPa}
"""Supply pressures (gauge); that of TC5 is from the paper's list of test conditions."""
OTHER_SUPPLY_KPA = {**SUPPLY_KPA, "tc5": _FIXED_KPA}
"""The same, but with the TC5 supply that the text below the list gives."""
BASE = Rig(cv=ControlVolume(1.0))
"""The default rig. Its valves and outlet are assumed where the paper states no data."""

SETTLE_S = 1.0
MEASURE_S = 1.5
CORNERS = 64
"""Corners of the polygon that approximates a cycle of the command."""
READINGS = 1000
"""Approximate number of readings in a slow cycle, which does not need a reading for each tick."""
TUBE_L = 0.0126
"""Volume of a metre of 4 mm tube."""

Benches = Mapping[tuple[float, ...], Setup]
"""The simulated bench for each set of values."""


@dataclass(frozen=True)
class Suspect:
    """A possible difference between the real bench and the baseline, with one parameter."""

    name: str
    parameter: str
    values: tuple[float, ...]
    """Tested values."""
    made: Callable[[float], Setup] | None = None
    """Makes the bench; None: apply the cause with this name."""

    def on(self, value: float) -> Setup:
        """The simulated bench with this difference."""
        return self.made(value) if self.made else setup(BASE, self.name, **{self.parameter: value})


def _tube(flow_resistance_kPa_s_per_SL: float) -> Setup:
    return _with_tube(setup(BASE), flow_resistance_kPa_s_per_SL)


def _with_tube(made: Setup, flow_resistance_kPa_s_per_SL: float) -> Setup:
    tubing = Hose(TUBE_L, flow_resistance_kPa_s_per_SL)
    return replace(made, plant=Plant(made.plant.rig, replace(made.plant.effects, tubing=tubing)))


def _outlet(scale: float) -> Setup:
    return setup(replace(BASE, solenoid=Solenoid(scale * BASE.solenoid.flow_resistance_kPa_s_per_SL)))


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
"""Minimum gains, as an error of the evaluation, not of the rig: drift and offset in an FFT over few cycles.
Their squares are added to those of the gains."""
WITH_TUBE = ("compressible_flow", "cv_heating")
AGAIN = ("evp_restriction", "cv_heating", "tube")
"""Also tested with the other supply pressure of TC5."""


@dataclass(frozen=True)
class GainExplanation:
    """The gains with some suspects, compared with the measured gains; tuples are in the order of `TESTS`."""

    names: tuple[str, ...]
    best: dict[str, float]
    """The tested value of each suspect that is best for both tests together."""
    rms_dB: tuple[float, ...]
    """Difference from the measured gains with the best values, over all points."""
    band_rms_dB: tuple[float, ...]
    """The same, up to `BAND` times the drawn cut-off frequency."""
    unseen_dB: tuple[float, ...]
    """Difference with the values that are best for the other test."""
    gains: tuple[Array, ...]

    @property
    def label(self) -> str:
        return " + ".join(self.names) or NONE

    @property
    def unseen(self) -> float:
        """Difference on unseen data over both tests, dB rms."""
        return rms(np.array(self.unseen_dB))


@dataclass(frozen=True)
class Responses:
    """All tested explanations, sorted by their difference on unseen data."""

    explanations: tuple[GainExplanation, ...]
    """With TC5 at 345 kPa."""
    other: tuple[GainExplanation, ...]
    """With TC5 at 690 kPa."""

    def of(self, *names: str, other: bool = False) -> GainExplanation:
        """The explanation with these suspects; with TC5 at 345 kPa, or at the `other` supply."""
        explanations = self.other if other else self.explanations
        return next(each for each in explanations if set(each.names) == set(names))


def explain(
    progress: Progress = silent,
    suspects: Sequence[Suspect] = SUSPECTS,
    with_tube: Sequence[str] = WITH_TUBE,
    again: Sequence[str] = AGAIN,
) -> Responses:
    """Compare the suspects with the measured gains.

    Args:
        progress: called with the current step and the completed share of the work.
        suspects: tested alone, with and without a floor; one of them must be the tube.
        with_tube: suspects that are also tested with a tube.
        again: suspects that are also tested with the other supply pressure of TC5.
    """
    by_name = {suspect.name: suspect for suspect in suspects}
    tested: dict[tuple[str, ...], Benches] = {(): {(): setup(BASE)}}
    tested |= {(each.name,): {(value,): each.on(value) for value in each.values} for each in suspects}
    for name in with_tube:
        both = product(by_name[name].values, by_name["tube"].values)
        tested[name, "tube"] = {(v, r): _with_tube(by_name[name].on(v), r) for v, r in both}
    runs = [(names, SUPPLY_KPA) for names in tested]
    runs += [(names, OTHER_SUPPLY_KPA) for names in [(), *((name,) for name in again)]]
    found: list[GainExplanation] = []
    with threadpool_limits(1):
        for done, (names, supply_kPa) in enumerate(runs):
            progress(f"frequency response: {' + '.join(names) or NONE}", done / len(runs))
            found += _explained(names, tested[names], supply_kPa)
    # Two explanations of each run: without and with a floor.
    first = 2 * len(tested)
    return Responses(_ordered(found[:first]), _ordered(found[first:]))


def _ordered(explanations: list[GainExplanation]) -> tuple[GainExplanation, ...]:
    return tuple(sorted(explanations, key=lambda explanation: explanation.unseen))


def _explained(
    names: tuple[str, ...], benches: Benches, supply_kPa: Mapping[str, float]
) -> list[GainExplanation]:
    """The explanations without and with a floor."""
    plain = {
        values: [gains(bench, test, supply_kPa[test]) for test in TESTS] for values, bench in benches.items()
    }
    floored = {
        (*values, floor): [np.hypot(g, floor) for g in found]
        for (values, found), floor in product(plain.items(), FLOORS)
    }
    return [_explanation(names, plain), _explanation((*names, FLOOR), floored)]


def _explanation(
    names: tuple[str, ...], simulated: Mapping[tuple[float, ...], list[Array]]
) -> GainExplanation:
    measured, tests = [measured_gains(test) for test in TESTS], range(len(TESTS))

    def off_dB(values: tuple[float, ...], test: int, cutoffs: float = inf) -> float:
        return measured[test].rms_dB(simulated[values][test], cutoffs)

    best = min(simulated, key=lambda values: sum(off_dB(values, test) ** 2 for test in tests))
    # `reversed` below: each test is predicted with the best values of the other.
    best_of = [min(simulated, key=partial(off_dB, test=test)) for test in tests]
    return GainExplanation(
        names=names,
        best=dict(zip(names, best, strict=True)),
        rms_dB=tuple(off_dB(best, test) for test in tests),
        band_rms_dB=tuple(off_dB(best, test, BAND) for test in tests),
        unseen_dB=tuple(off_dB(values, test) for test, values in enumerate(reversed(best_of))),
        gains=tuple(simulated[best]),
    )


def gains(made: Setup, test: str, supply_kPa: float) -> Array:
    """Amplitude of the pressure over that of the command, at each measured frequency, at constant supply."""
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
    """The gain at one frequency, from whole cycles after settling. The command is a polygon."""
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
