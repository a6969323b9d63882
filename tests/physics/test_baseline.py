"""The baseline plant agrees with closed forms."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.physics.baseline import BaselineFlows, BaselineState, Inputs, derivatives, flows, step
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.rig import ControlVolume, Rig

RIG = Rig()
SHUT = Inputs(0.0, 0.0, False)

openings = st.floats(0.0, 1.0)
inputs_strategy = st.builds(Inputs, openings, st.one_of(st.just(0.0), openings), st.booleans())
states = st.builds(BaselineState, st.floats(50.0, 760.0), st.floats(-50.0, 30.0))


def run(rig: Rig, state: BaselineState, inputs: Inputs, seconds: float) -> BaselineState:
    for _ in range(round(seconds * 1000)):
        state = step(rig, state, inputs, 0.001)
    return state


def test_each_flow_is_its_own_ohms_law() -> None:
    state = BaselineState(690.0, 20.0)
    assert flows(RIG, state, Inputs(0.5, 0.0, False)) == BaselineFlows(0.5 * 670.0 / 2042.0, 0.0, 0.0)
    assert flows(RIG, state, Inputs(0.0, 0.5, False)) == BaselineFlows(0.0, 0.5 * 690.0 / 618.0, 0.0)
    assert flows(RIG, state, Inputs(0.0, 0.0, True)) == BaselineFlows(0.0, 0.0, 20.0 / 70.0)
    assert flows(RIG, state, Inputs(0.0, 0.5, True)).outlet_SL_per_s == pytest.approx((20.0 + 27.5) / 70.0)


def test_the_venturi_is_weaker_below_its_rated_supply() -> None:
    assert flows(RIG, BaselineState(300.0, 0.0), Inputs(0.0, 1.0, True)).outlet_SL_per_s == pytest.approx(
        27.5 / 70.0
    )


def test_air_comes_back_through_a_venturi_at_rest_only() -> None:
    below_ambient = BaselineState(690.0, -20.0)
    assert flows(RIG, below_ambient, Inputs(0.0, 0.0, True)).outlet_SL_per_s == pytest.approx(-20.0 / 70.0)
    assert flows(RIG, below_ambient, Inputs(0.0, 0.1, True)).outlet_SL_per_s == 0.0
    assert flows(RIG, below_ambient, Inputs(0.0, 1.0, True)).outlet_SL_per_s == pytest.approx(35.0 / 70.0)


def test_discharge_to_atmosphere_is_the_papers_exponential() -> None:
    """P_r = P_r0 exp(−t/τ), τ = R_v V_r / α; the paper's 2 L reservoir at its flow resistance: τ = 40.3 s."""
    rig = dataclasses.replace(
        RIG, cv=None, evp=dataclasses.replace(RIG.evp, flow_resistance_kPa_s_per_SL=20.1535 * ALPHA_KPA)
    )
    state = run(rig, BaselineState(689.5, 0.0), Inputs(1.0, 0.0, False), 10.0)
    assert state.reservoir_kPa == pytest.approx(689.5 * math.exp(-10.0 / 40.307), rel=1e-5)
    assert state.cv_kPa == 0.0


def test_inflation_speed_is_the_papers() -> None:
    """dP_cv/dt = α P_r / (R_v V_cv): 68.4 kPa/s for 0.5 L at 690 kPa."""
    rig = dataclasses.replace(RIG, cv=ControlVolume(volume_L=0.5))
    _, cv_rate = derivatives(rig, BaselineState(690.0, 0.0), Inputs(1.0, 0.0, False))
    assert cv_rate == pytest.approx(ALPHA_KPA * 690.0 / (2042.0 * 0.5))
    assert cv_rate == pytest.approx(68.4, rel=0.01)


def test_passive_venting_is_an_exponential() -> None:
    state = run(RIG, BaselineState(690.0, 20.0), Inputs(0.0, 0.0, True), 0.2)
    assert state.cv_kPa == pytest.approx(20.0 * math.exp(-0.2 * ALPHA_KPA / (70.0 * 0.1)), rel=1e-6)
    assert state.reservoir_kPa == 690.0


@given(states)
def test_shut_valves_keep_everything(state: BaselineState) -> None:
    assert run(RIG, state, SHUT, 0.01) == state


@given(states, openings)
def test_inflation_loses_no_air(state: BaselineState, evp: float) -> None:
    after = run(RIG, state, Inputs(evp, 0.0, False), 0.05)
    lost = (state.reservoir_kPa - after.reservoir_kPa) * RIG.reservoir.volume_L
    assert RIG.cv is not None
    assert (after.cv_kPa - state.cv_kPa) * RIG.cv.volume_L == pytest.approx(lost, abs=1e-9)


@given(states, inputs_strategy)
def test_halving_the_step_changes_nothing_that_matters(state: BaselineState, inputs: Inputs) -> None:
    whole = step(RIG, state, inputs, 0.001)
    halves = step(RIG, step(RIG, state, inputs, 0.0005), inputs, 0.0005)
    # At the backflow limit the law has a kink, so the order of convergence is lower.
    assert halves == pytest.approx(whole, abs=1e-3)


@given(states, inputs_strategy)
def test_a_running_venturi_never_feeds_the_control_volume(state: BaselineState, inputs: Inputs) -> None:
    if inputs.dvp > 0.0:
        assert flows(RIG, state, inputs).outlet_SL_per_s >= 0.0
