"""One flight of each kind of the soak test, and its judgement. benchmarks/soak.py runs it for a day."""

from __future__ import annotations

import pytest
from required_programs import needs_compiler
from soak import Outcome, Sample, simulated
from soak_day import BUTTONS, Tally, bend

from flying_vines.vehicle.mission.item import AutopilotKind

pytestmark = pytest.mark.long


@needs_compiler
@pytest.mark.parametrize(
    ("kind", "seed", "by"),
    [("ardupilot", 10, "mission item"), ("px4", 36, "command"), ("ardupilot", 2, "switch")],
)
def test_every_trigger_of_a_flight_causes_a_motion(
    kind: AutopilotKind, seed: int, by: str, capsys: pytest.CaptureFixture[str]
) -> None:
    outcome = simulated(kind, seed, 1.0, 1.0)
    tally = outcome.world.tally
    assert tally.violations == []
    assert set(tally.triggers) == {by}
    assert tally.flights == 1
    assert tally.triggers.total() == tally.motions == outcome.decisions["accepted"] >= 3
    assert outcome.good
    assert len(capsys.readouterr().out.splitlines()) == 1


def judged(motion_of_the_plant: dict[float, float], until_s: float = 12.0, angle_deg: float = 30.0) -> Tally:
    """The judgement of a bend at 1 s, with the plant's pressures from these times on."""
    tally = Tally()
    cv_kPa = 0.0
    for tenth in range(round(until_s * 10)):
        t = tenth / 10
        if tenth == 10:
            tally.trigger(t, "switch", bend(angle_deg))
        cv_kPa = motion_of_the_plant.get(t, cv_kPa)
        tally.look(t, cv_kPa)
    return tally


def test_an_expected_motion_is_no_violation() -> None:
    tally = judged({1.4: 11.4})
    assert (tally.motions, tally.violations) == (1, [])


@pytest.mark.parametrize(
    ("plant", "motions", "violation"),
    [
        ({}, 0, "at 3.5 s: 0.0 kPa since bend 30° at 1.0 s"),
        ({1.4: 11.4, 1.9: 20.7}, 0, "at 3.5 s: 20.7 kPa since bend 30° at 1.0 s"),
        ({1.4: 11.4, 8.0: 0.0}, 1, "at 8.0 s: 0.0 kPa since bend 30° at 1.0 s"),
        ({0.5: 6.0, 1.4: 11.4}, 1, "at 0.5 s: 6.0 kPa since the start at 0.0 s"),
        ({4.0: 11.4}, 0, "at 3.5 s: 0.0 kPa since bend 30° at 1.0 s"),
    ],
)
def test_a_missed_motion_or_one_without_a_request_is_a_violation(
    plant: dict[float, float], motions: int, violation: str
) -> None:
    tally = judged(plant)
    assert tally.motions == motions
    assert tally.violations[0] == violation


def test_a_wave_without_oscillation_is_a_violation() -> None:
    tally = Tally()
    tally.trigger(0.0, "command", BUTTONS[3])
    for tenth in range(100):
        tally.look(tenth / 10, 0.0)
    assert tally.motions == 0
    assert len(tally.violations) == 1


def test_memory_that_grows_is_not_flat() -> None:
    def flat(*ends: tuple[float, int | None]) -> bool:
        outcome = Outcome.__new__(Outcome)
        outcome.samples = [Sample(hour, 0.0, rss_MB, blocks) for hour, (rss_MB, blocks) in enumerate(ends)]
        return outcome.flat

    assert flat((40.0, 100_000), (47.0, 120_000), (41.0, 100_500))
    assert not flat((40.0, 100_000), (40.0, 106_000))
    assert not flat((40.0, None), (46.0, None))
