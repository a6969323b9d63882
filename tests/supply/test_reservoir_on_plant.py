"""The estimate on the high-fidelity plant with the firmware's regulator, for three rigs unknown to it.

`benchmarks/cycles_left.py` does the same with hundreds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from plant_telemetry import telemetry_of

from firmware_link.protocol import Telemetry
from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics import paper
from flying_vines.physics.plant.effects import Effects, likely_effects
from flying_vines.physics.plant.flow import Ohm
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.sensors import HONEYWELL_15BAR, HONEYWELL_30PSI, Adc
from flying_vines.physics.plant.volume import Compliant, Pouch
from flying_vines.physics.rig import ControlVolume, Reservoir, Rig
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop
from flying_vines.simulation.phlosar.firmware import Tuning
from flying_vines.supply import CyclesLeft, ReservoirEstimate, TelemetryReader, nominal

BELIEVED = PneumaticsConfig(reservoir_volume_L=1.0, cv_volume_L=0.25)
WAIT_S = 8.0
TOP_KPA = 20.7


@dataclass(frozen=True)
class Flight:
    plant: Plant
    tuning: Tuning
    cycle_s: float = 3.0
    up_s: float = 0.6
    until_s: float = math.inf
    """From this time on the vine is vented."""

    def setpoint_kPa(self, t_s: float) -> float:
        """The setpoint rises, stays at the top for a second, falls, and rests."""
        phase = (t_s - WAIT_S) % self.cycle_s
        down = (phase - self.up_s - 1.0) / self.up_s
        return TOP_KPA * max(0.0, min(1.0, phase / self.up_s, 1.0 - down))


def real(cv_L: float, effects: Effects) -> Plant:
    return Plant(Rig(Reservoir(0.97), ControlVolume(cv_L)), effects)


def rigs() -> Iterator[Flight]:
    likely = likely_effects(pouch=False)
    passive = {"venturi_least_supply_kPa": math.inf}
    leaking = replace(likely, reservoir_leak=Ohm(40_000.0), cv_leak=Ohm(15_000.0))
    yield Flight(real(0.3, leaking), passive)
    yield Flight(real(0.2, replace(likely, cv_shape=Compliant(0.01))), passive, cycle_s=5.0)
    eager = {"active_error_kPa": 1.0, "passive_error_kPa": 0.5, "arrival_s": 0.02, "passive_first_s": 0.0}
    yield Flight(real(0.25, replace(likely, cv_shape=Pouch(0.03))), eager, cycle_s=4.0)


def flown(flight: Flight, seconds: float) -> Iterator[tuple[float, Telemetry]]:
    times = np.arange(WAIT_S, min(seconds, flight.until_s), 0.02).tolist()
    rate = TOP_KPA / flight.up_s
    setpoints = [SetpointChange(t, flight.setpoint_kPa(t + 0.02), rate) for t in times]
    if flight.until_s < seconds:
        setpoints.append(SetpointChange(flight.until_s, math.nan, math.inf))
    run = closed_loop(
        flight.plant,
        setpoints,
        seconds,
        at_rest(flight.plant, 600.0),
        tuning=flight.tuning,
        cv_sensor=replace(HONEYWELL_30PSI, adc=Adc(10)),
        reservoir_sensor=replace(HONEYWELL_15BAR, adc=Adc(10), offset_kPa=6.0),
        seed=4,
    )
    return telemetry_of(run)


def by_paper(reservoir_kPa: float) -> float:
    return paper.n_cycles(
        reservoir_kPa,
        reservoir_volume_L=BELIEVED.reservoir_volume_L,
        cv_volume_L=BELIEVED.cv_volume_L,
        swing_kPa=BELIEVED.cycle_swing_kPa,
        rate_kPa_per_s=BELIEVED.cycle_rate_kPa_per_s,
        flow_resistance_kPa_s_per_SL=BELIEVED.evp_flow_resistance_kPa_s_per_SL,
    )


@pytest.mark.parametrize("flight", list(rigs()), ids=["leaking", "compliant", "venturi-and-pouch"])
def test_an_early_prediction_holds(flight: Flight) -> None:
    reader, estimate = TelemetryReader(nominal(BELIEVED)), ReservoirEstimate(nominal(BELIEVED))
    predicted: dict[int, tuple[CyclesLeft, float]] = {}
    best_kPa, missed, cycle = 0.0, 0, 0
    for t, telemetry in flown(flight, 700.0):
        if t >= WAIT_S + (cycle + 1) * flight.cycle_s:
            cycle += 1
            missed = missed + 1 if best_kPa < TOP_KPA - 2.07 else 0
            best_kPa = 0.0
            if missed == 3:
                break
            left = estimate.cycles_left()
            assert left is not None
            predicted[cycle] = left, by_paper(estimate.reservoir_kPa)
        best_kPa = max(best_kPa, telemetry.cv_kPa)
        # The later cycles are only counted, for the true number.
        if cycle <= 15:
            estimate.update(reader.read(t, telemetry))
    assert missed == 3, "the reservoir lasted too long for this test"
    total = cycle - missed
    assert total > 25
    for after, within in ((5, 0.15), (15, 0.1)):
        left, by_formula = predicted[after]
        truth = total - after
        assert left.low <= truth <= left.high
        assert left.expected == pytest.approx(truth, rel=within, abs=1.0)
        assert abs(left.expected - truth) < abs(by_formula - truth)


def test_a_pause_after_fast_cycles_changes_the_prediction_little() -> None:
    fast_until_s = WAIT_S + 10 * 1.9
    tight = replace(likely_effects(pouch=False), reservoir_leak=None)
    flight = Flight(real(0.25, tight), {}, 1.9, 0.4, fast_until_s)
    reader, estimate = TelemetryReader(nominal(BELIEVED)), ReservoirEstimate(nominal(BELIEVED))
    lowest_kPa = math.inf
    after_cycles: CyclesLeft | None = None
    for t, telemetry in flown(flight, fast_until_s + 40.0):
        estimate.update(reader.read(t, telemetry))
        lowest_kPa = min(lowest_kPa, estimate.reservoir_kPa)
        if t >= fast_until_s + 0.5 and round(100.0 * t) % 50 == 0:
            left = estimate.cycles_left()
            assert left is not None
            after_cycles = after_cycles or left
            assert after_cycles.low < left.expected < after_cycles.high
            assert left.expected == pytest.approx(after_cycles.expected, rel=0.06)
    assert after_cycles is not None
    assert estimate.reservoir_kPa > lowest_kPa + after_cycles.cost_kPa, "more than a cycle's worth came back"
