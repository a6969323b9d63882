"""Pressure and air along a mission agree with a simulated flight of the service."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import pytest
from mission_building import (
    DELAY,
    HEAD,
    HOME,
    LAND,
    SCRIPT,
    TAKEOFF,
    WP,
    built,
    finding_texts,
    items,
    reviewed,
    waypoint,
)

from flying_vines.config import config as configuration
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import Rig
from flying_vines.simulation.simulated_world import fly, with_flight
from flying_vines.supply import nominal
from flying_vines.vehicle.mission.item import AutopilotKind
from missions.budget import PlannedBend, budget
from missions.home import SIMULATOR_HOME, Home
from missions.report import as_json, review
from missions.timeline import timeline

CONFIG = configuration.default()
IDEAL = TrueRig(Rig(), effects=Effects())
"""Fast, and good enough if only the decision matters."""
REACH = HEAD + waypoint("{ profile = 'reach' }")
SHORT = HEAD.replace("10", "5") + waypoint(
    "{ bend_deg = 30, hold_s = 2 }, { profile = 'straight' }", "north_m = 5"
)


def test_a_leg_takes_its_distance_and_climb() -> None:
    given = built(
        HEAD + waypoint("", "north_m = 40\nstay_s = 3") + waypoint("", "north_m = 40\naltitude_m = 30"), "px4"
    )
    steps = timeline(given, "px4", SIMULATOR_HOME["px4"]).steps
    assert [round(step.takes_s, 2) for step in steps[:3]] == [4.0, 8.0 + 3.0, 8.0]
    assert steps[1].distance_m == pytest.approx(40.0, abs=0.02)
    # 28 m at 2.5 m/s, and the last 2 m at 0.5 m/s.
    assert steps[3].takes_s == pytest.approx(28 / 2.5 + 2 / 0.5)


def test_a_slower_vehicle_takes_longer() -> None:
    text = HEAD + waypoint("", "north_m = 40")
    slow = built("speed_m_s = 2\n" + text, "ardupilot")
    step = next(
        step for step in timeline(slow, "ardupilot", SIMULATOR_HOME["ardupilot"]).steps if step.waypoint == 1
    )
    assert step.takes_s == pytest.approx(20.0, abs=0.01)


def test_a_bend_has_the_pressure_of_the_curve_and_takes_air() -> None:
    bend = reviewed(built(REACH, "px4"), "px4").budget.bends[0]
    assert bend.motion is not None
    assert bend.motion.top_kPa == pytest.approx(CONFIG.vine.bend_curve().pressure_kPa(45.0))
    assert bend.ends_s - bend.step.t_s == pytest.approx(5.0)
    # 0.1 L to 16 kPa from 2 L: 0.8 kPa for a rigid vine, and several times that for a real one.
    assert 0.8 < bend.air_kPa < 10.0
    assert bend.after.expected == pytest.approx(bend.before.expected - bend.air_kPa)
    assert bend.after.high - bend.after.low > bend.before.high - bend.before.low


def test_a_refused_item_changes_nothing_of_the_bend_before_it() -> None:
    def first_bend(*between: tuple[float, ...]) -> PlannedBend:
        reach, waits = (SCRIPT, 2), ((DELAY, 2), *between, (DELAY, 8))
        return reviewed(items(HOME, (TAKEOFF,), (WP,), reach, *waits, (LAND,)), "ardupilot").budget.bends[0]

    alone, followed = first_bend(), first_bend((SCRIPT, 1, 90))
    assert followed.ends_s - followed.step.t_s == pytest.approx(5.0)
    assert (followed.ends_s, followed.bent_s) == (alone.ends_s, alone.bent_s)
    assert followed.air_kPa == pytest.approx(alone.air_kPa, abs=0.01)
    assert followed.after.low == pytest.approx(alone.after.low, abs=0.01)


def test_more_bends_take_more_air_and_leave_fewer_cycles() -> None:
    budgets = [
        reviewed(built(HEAD + waypoint(", ".join(["{ profile = 'reach' }"] * n)), "px4"), "px4").budget
        for n in (1, 3, 6)
    ]
    ends = [b.ends.expected for b in budgets]
    left = [b.bends[-1].cycles.expected for b in budgets if b.bends[-1].cycles]
    assert ends == sorted(ends, reverse=True) and left == sorted(left, reverse=True)
    assert ends[0] - ends[2] > 5.0


def test_without_a_vine_item_only_the_assumed_leak_takes_air() -> None:
    report = reviewed(built(HEAD + waypoint("", "north_m = 100"), "px4"), "px4")
    leak = nominal(CONFIG.pneumatics).leak.mean
    lost = report.budget.begins.expected - report.budget.ends.expected
    assert lost == pytest.approx(690.0 * leak * report.budget.length_s, rel=0.15)


def test_a_vine_with_hysteresis_is_let_down_further() -> None:
    vine = msgspec.structs.replace(CONFIG.vine, hysteresis_kPa=3.0)
    config = msgspec.structs.replace(CONFIG, vine=vine)
    given = built(HEAD + waypoint("{ bend_deg = 50 }, { bend_deg = 30 }"), "px4", config)
    plan = timeline(given, "px4", SIMULATOR_HOME["px4"])
    bends = budget(plan, config, nominal(config.pneumatics), 690.0).bends
    final = [bend.motion.final_kPa for bend in bends if bend.motion]
    up = vine.bend_curve().pressure_kPa(30.0)
    assert final[1] == pytest.approx(up - 3.0)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_the_service_flies_as_the_budget_predicts(kind: AutopilotKind) -> None:
    given = built(SHORT, kind)
    prior = nominal(CONFIG.pneumatics)
    report = review("short", given, kind, SIMULATOR_HOME[kind], CONFIG, prior, 690.0)
    report = with_flight(report, CONFIG, 690.0)
    assert report.flight_result is not None and report.flight_result.landed
    assert report.differences == []
    assert [item.seq for item in report.flight_result.ran] == [
        bend.step.item.seq for bend in report.budget.bends
    ]
    assert [decision.intent for decision in report.flight_result.decisions] == ["bend 30°", "straight"]
    budget = report.budget
    assert budget.ends.low < report.flight_result.ends_kPa < budget.ends.high
    otherwise = replace(report.flight_result, ran=(), ends_kPa=300.0, landed=False)
    said = " ".join(replace(report, flight_result=otherwise).differences)
    assert "items [] ran, not" in said and "the reservoir lost" in said and "had not landed" in said
    found = as_json(report)["trial"]
    assert found["items"] == [bend.step.item.seq for bend in report.budget.bends]


@pytest.mark.parametrize(
    ("reservoir_kPa", "verdict"), [pytest.param(48.0, "refused", marks=pytest.mark.long), (70.0, "limited")]
)
def test_a_low_reservoir_is_judged_as_the_service_judges_it(reservoir_kPa: float, verdict: str) -> None:
    given = built(SHORT, "px4")
    report = reviewed(given, "px4", reservoir_kPa=reservoir_kPa)
    flown = fly(given, CONFIG, "px4", SIMULATOR_HOME["px4"], reservoir_kPa, report.timeline.length_s, IDEAL)
    assert report.budget.bends[0].ruling.verdict == verdict
    assert flown.decisions[0].safety == verdict
    words = report.budget.bends[0].ruling.reason.split(" kPa")[0].rstrip("0123456789")
    assert flown.decisions[0].reason.startswith(words)


def test_a_mission_with_errors_is_not_flown() -> None:
    given = built(SHORT.replace("= 5\n", "= 1\n"), "px4")
    home: Home = SIMULATOR_HOME["px4"]
    report = review("low", given, "px4", home, CONFIG, nominal(CONFIG.pneumatics), 690.0)
    report = with_flight(report, CONFIG, 690.0)
    assert finding_texts(report) and report.flight_result is None
