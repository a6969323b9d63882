from __future__ import annotations

import random

import msgspec
import pytest

from flying_vines import config
from flying_vines.config import Pneumatics
from flying_vines.reservoir import ReservoirEstimate, floor_kPa, n_cycles

DEMONSTRATION = Pneumatics()


def test_the_papers_demonstration_gives_its_number() -> None:
    assert n_cycles(DEMONSTRATION, 690.0) == pytest.approx(311.0, abs=0.5)


def test_no_cycles_below_the_floor() -> None:
    floor = floor_kPa(DEMONSTRATION, DEMONSTRATION.cycle_rate_kPa_per_s)
    assert floor == pytest.approx(45.95, abs=0.05)
    assert n_cycles(DEMONSTRATION, floor) == pytest.approx(0.0, abs=1e-9)
    assert n_cycles(DEMONSTRATION, 0.0) == 0.0


def fly(
    cost_kPa: float, cycles: int, noise_kPa: float = 1.2, start_kPa: float = 690.0, seed: int = 1
) -> tuple[ReservoirEstimate, float]:
    """Cycles of 20.7 kPa that take `cost_kPa` each, seen at 100 Hz through a noisy sensor."""
    estimate = ReservoirEstimate(DEMONSTRATION)
    noise = random.Random(seed)
    reservoir, t = start_kPa, 0.0

    def see(seconds: float, cv_from: float, cv_to: float, used: float) -> None:
        nonlocal reservoir, t
        steps = round(seconds * 100)
        for i in range(steps):
            reservoir -= used / steps
            t += 0.01
            cv = cv_from + (cv_to - cv_from) * i / steps
            estimate.update(t, noise.gauss(cv, 0.15), noise.gauss(reservoir, noise_kPa))

    see(2.0, 0.0, 0.0, 0.0)
    for _ in range(cycles):
        see(0.4, 0.0, 20.7, cost_kPa)
        see(1.0, 20.7, 20.7, 0.0)
        see(0.3, 20.7, 0.0, 0.0)
        see(1.2, 0.0, 0.0, 0.0)
    return estimate, reservoir


@pytest.mark.parametrize("cost_kPa", [1.03, 2.07, 6.1, 12.2])
def test_learns_what_a_cycle_costs(cost_kPa: float) -> None:
    estimate, reservoir = fly(cost_kPa, 12)
    left = estimate.cycles_left()
    assert left is not None
    truth = (reservoir - 45.95) / cost_kPa
    assert left.measured_cycles == pytest.approx(12.0, abs=0.6)
    assert left.low < truth < left.high
    assert left.expected == pytest.approx(truth, rel=0.2)


def test_before_use_the_interval_reaches_from_pouch_to_rigid() -> None:
    estimate, _ = fly(2.07, 0)
    left = estimate.cycles_left()
    assert left is not None
    assert left.low < 644 / (2.07 * 2.9) < 644 / 1.04 < left.high


def test_the_interval_shrinks_with_use() -> None:
    widths = []
    for cycles in (0, 3, 20):
        left = fly(6.1, cycles)[0].cycles_left()
        assert left is not None
        widths.append((left.high - left.low) / left.expected)
    assert widths[0] > widths[1] > widths[2]


def test_the_interval_holds_the_truth_on_most_rigs() -> None:
    dice = random.Random(7)
    held = 0
    for seed in range(40):
        cost = dice.uniform(1.0, 10.0)
        estimate, reservoir = fly(cost, 6, seed=seed)
        left = estimate.cycles_left()
        assert left is not None
        held += left.low <= (reservoir - 45.95) / cost <= left.high
    assert held >= 34


def test_a_refill_is_no_cycle_and_no_gain_per_cycle() -> None:
    estimate, _ = fly(6.1, 10, start_kPa=400.0)
    before = estimate.cycles_left()
    estimate.update(1000.0, 0.0, 690.0)
    after = estimate.cycles_left()
    assert before is not None
    assert after is not None
    assert after.cost_kPa == pytest.approx(before.cost_kPa)
    assert after.expected > before.expected


def test_idling_costs_nothing() -> None:
    estimate = ReservoirEstimate(config.default().pneumatics)
    for i in range(1000):
        estimate.update(i * 0.01, 0.1, 690.0 - 0.01 * i)
    left = estimate.cycles_left()
    assert left is not None
    assert left.measured_cycles == 0.0


def test_nothing_is_known_before_the_first_reading() -> None:
    assert ReservoirEstimate(DEMONSTRATION).cycles_left() is None


def test_what_a_rise_takes_scales_with_it() -> None:
    estimate, _ = fly(6.1, 10)
    assert estimate.spending_kPa(20.7) == pytest.approx(6.1, rel=0.15)
    assert estimate.spending_kPa(41.4) == pytest.approx(2 * estimate.spending_kPa(20.7))
    bigger = msgspec.structs.replace(DEMONSTRATION, reservoir_volume_L=4.0)
    assert n_cycles(bigger, 690.0) == pytest.approx(2 * n_cycles(DEMONSTRATION, 690.0), rel=1e-9)
