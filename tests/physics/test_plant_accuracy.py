"""The fast integrator agrees with scipy's stiff one and with itself in finer steps."""

from __future__ import annotations

import dataclasses
import itertools
import random

import pytest

from flying_vines.physics.baseline import Inputs
from flying_vines.physics.plant.ambient import Climb, air_at
from flying_vines.physics.plant.effects import Effects, likely_effects
from flying_vines.physics.plant.plant import Conditions, Held, Plant
from flying_vines.physics.plant.rates import conditions, rates
from flying_vines.physics.plant.simulator import Simulator
from flying_vines.physics.plant.tick import _MAX_STEP
from flying_vines.physics.plant.valve_response import Coil
from flying_vines.physics.plant.venturi import Ejector
from flying_vines.physics.plant.volume import Compliant
from flying_vines.physics.rig import ControlVolume, Rig

STEADY_COIL = Coil(thermal_resistance_K_per_W=0.0)
"""Without warming, the targets change only with the command, so scipy can solve piecewise."""
EVERYTHING = dataclasses.replace(
    likely_effects(), evp_coil=STEADY_COIL, dvp_coil=STEADY_COIL, ambient=Climb(0.05)
)


def switching(seconds: float, seed: int) -> list[Inputs]:
    """Inflate, trim, hold, vent passively, vent with the Venturi: about a second each."""
    rng = random.Random(seed)
    given_commands: list[Inputs] = []
    while len(given_commands) < round(seconds * 1000):
        command = rng.choice(
            [
                Inputs(1.0, 0.0, False),
                Inputs(rng.uniform(0.3, 0.9), 0.0, False),
                Inputs(0.0, 0.0, False),
                Inputs(0.0, 0.0, True),
                Inputs(0.0, rng.choice([0.6, 1.0]), True),
            ]
        )
        given_commands += [command] * rng.randrange(100, 2000)
    return given_commands[: round(seconds * 1000)]


def difference_kPa(a: Conditions, b: Conditions) -> float:
    return max(abs(x - y) for x, y in zip(a[:3], b[:3], strict=True))


COMPLIANT = dataclasses.replace(
    EVERYTHING, tubing=None, cv_shape=Compliant(0.01), ejector=Ejector(), solenoid_law=None
)
RIGID = dataclasses.replace(EVERYTHING, cv_shape=None)


@pytest.mark.parametrize(
    ("effects", "cv_L", "seconds"),
    [
        pytest.param(EVERYTHING, 0.1, 8.0, id="everything"),
        pytest.param(EVERYTHING, 0.1, 45.0, id="everything, long", marks=pytest.mark.long),
        pytest.param(RIGID, 0.5, 8.0, id="rigid half litre", marks=pytest.mark.long),
        pytest.param(COMPLIANT, 0.1, 8.0, id="compliant without tube", marks=pytest.mark.long),
        pytest.param(Effects(), 0.1, 45.0, id="baseline", marks=pytest.mark.long),
    ],
)
def test_it_agrees_with_radau_to_a_hundredth_of_a_kilopascal(
    effects: Effects, cv_L: float, seconds: float
) -> None:
    integrate = pytest.importorskip("scipy.integrate", reason="pip install scipy to compare with Radau")
    plant = Plant(Rig(cv=ControlVolume(cv_L)), effects)
    simulator = Simulator(plant)
    numbers, y = simulator.numbers, list(simulator.state)
    ours: list[Conditions] = []
    held: list[Held] = []
    for command in switching(seconds, 7):
        simulator.advance(command)
        ours.append(simulator.conditions)
        held.append(simulator.held)
    start_s, worst = 0.0, 0.0
    for piece, group in itertools.groupby(range(len(held)), key=held.__getitem__):
        ends_s = [(tick + 1) / 1000.0 for tick in group]
        solution = integrate.solve_ivp(
            lambda t, y, piece: rates(numbers, air_at(plant.ambient, t), 0.0, tuple(y), piece),
            (start_s, ends_s[-1]),
            y,
            "Radau",
            t_eval=ends_s,
            args=(piece,),
            rtol=1e-9,
            atol=1e-10,
        )
        assert solution.success, solution.message
        for t_s, state in zip(ends_s, solution.y.T.tolist(), strict=True):
            found = conditions(numbers, air_at(plant.ambient, t_s), tuple(state))
            worst = max(worst, difference_kPa(found, ours[round(t_s * 1000) - 1]))
        y, start_s = solution.y[:, -1].tolist(), ends_s[-1]
    print(f"{worst:.1e} kPa, {len(set(held))} different pieces")
    assert worst < 0.01


@pytest.mark.long
def test_finer_steps_change_less_than_a_hundredth_of_a_kilopascal() -> None:
    """Also with warming coils, without scipy."""
    plant = Plant(Rig(), likely_effects())
    usual, fine = Simulator(plant), Simulator(plant)
    fine.numbers = fine.numbers._replace(standing_per_s=16.0 * _MAX_STEP / fine.numbers.tick_s)
    worst = 0.0
    for command in switching(3.0, 5):
        usual.advance(command)
        fine.advance(command)
        worst = max(worst, difference_kPa(usual.conditions, fine.conditions))
    print(f"{worst:.1e} kPa")
    assert worst < 0.01
