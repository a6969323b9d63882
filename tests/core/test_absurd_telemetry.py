"""Telemetry frames with a valid CRC and impossible readings, and all possible readings."""

from __future__ import annotations

import dataclasses
import itertools
import math
import random
from collections.abc import Iterator

import pytest

from firmware_link import protocol
from firmware_link.host import PLAUSIBLE_KPA
from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.config import config
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.supply import ReservoirEstimate, TelemetryReader, nominal
from flying_vines.supply.physics_checks import PhysicsChecks

from .flights import HIGH, LOW, airborne, assert_vented, bent, decisions, notices, run_for, shown

ABSURD = [1e30, 1e20, 1e12, 1e9, 5e3, -1e3, -1e9, -1e30, math.nan, math.inf, -math.inf]
TEXTS = {
    "cv_kPa": "Vine: vine sensor reads ",
    "reservoir_kPa": "Vine: reservoir sensor reads ",
    "setpoint_kPa": "Vine: phloSAR setpoint is ",
}


class Spoiled:
    """The wire from the board, which can replace readings."""

    def __init__(self, flight: SimulatedFlight) -> None:
        self.frames = 0
        self.values: dict[str, float] = {}
        self._decoder, self._encoder = protocol.Codec(), protocol.Codec()
        flight.world.from_phlosar = self.spoil

    def spoil_next(self, frames: int, values: dict[str, float]) -> None:
        """Put `values` into the next `frames` of telemetry."""
        self.frames, self.values = frames, values

    def spoil(self, data: bytes) -> bytes:
        return b"".join(map(self._encoder.encode, map(self._spoiled, self._decoder.decode(data))))

    def _spoiled(self, message: protocol.Message) -> protocol.Message:
        if not isinstance(message, Telemetry) or not self.frames:
            return message
        self.frames -= 1
        return dataclasses.replace(message, **self.values)  # type: ignore[arg-type]


@pytest.mark.parametrize("bends", [False, True])
def test_one_absurd_frame_changes_nothing(bends: bool) -> None:
    flight = bent() if bends else airborne()
    wire = Spoiled(flight)
    for field, value in itertools.product(PLAUSIBLE_KPA, ABSURD):
        wire.spoil_next(1, {field: value})
        actions = run_for(flight, 0.2)
        assert decisions(actions) == [] and notices(actions) == [], (field, value)
        assert flight.core.snapshot(flight.world.now).safe_state == {}
    actions = run_for(flight, 2.0)
    assert decisions(actions) == [] and notices(actions) == []
    cycles = flight.core.snapshot(flight.world.now).cycles
    assert cycles is not None and math.isfinite(cycles.expected)
    assert (flight.phlosar.cv_kPa > 15.0) is bends


@pytest.mark.parametrize("setpoint_kPa", [0.0, 5.0, 100.0, 400.0])
def test_one_wrong_setpoint_in_a_bend_is_no_other_kind_of_bend(setpoint_kPa: float) -> None:
    cycles = []
    for values in ({}, {"setpoint_kPa": setpoint_kPa}):
        flight = airborne()
        wire = Spoiled(flight)
        texts: list[str] = []
        for _ in range(4):
            flight.autopilot.set_rc(9, HIGH)
            texts += shown(run_for(flight, 2.0))
            wire.spoil_next(1, values)
            texts += shown(run_for(flight, 0.5))
            flight.autopilot.set_rc(9, LOW)
            texts += shown(run_for(flight, 2.0))
        assert texts == []
        cycles.append(flight.core.snapshot(flight.world.now).cycles)
    assert cycles[0] is not None and cycles[1] is not None
    assert cycles[1].expected == pytest.approx(cycles[0].expected, rel=0.02)


@pytest.mark.parametrize("field", PLAUSIBLE_KPA)
@pytest.mark.parametrize("value", [1e30, -1e30, math.nan])
def test_an_impossible_reading_is_a_fault_that_a_person_clears(field: str, value: float) -> None:
    flight = bent()
    Spoiled(flight).spoil_next(10, {field: value})
    actions = run_for(flight, 1.0)
    (lost,) = decisions(actions)
    assert lost.what == {"loss": "sensor"} and lost.t - 10.0 < 0.05
    texts = [text for text in notices(actions) if "waiting for" not in text]
    assert [text for text in texts if text.startswith(TEXTS[field])] == texts
    assert_vented(flight)
    flight.autopilot.set_rc(9, LOW)
    (cleared,) = (text for text in notices(run_for(flight, 1.0)) if "cleared" in text)
    assert cleared.replace("cleared: ", "").startswith(TEXTS[field])
    flight.autopilot.set_rc(9, HIGH)
    assert [d.safety for d in decisions(run_for(flight, 2.0))] == ["accepted"]
    assert flight.phlosar.cv_kPa == pytest.approx(20.7, abs=1.0)


def test_a_fault_that_comes_again_after_it_was_cleared_is_told_within_a_second() -> None:
    flight = bent()
    spoiled, texts = Spoiled(flight), []
    for _ in range(2):
        spoiled.spoil_next(10, {"cv_kPa": 1e30})
        texts += shown(run_for(flight, 0.5))
        flight.autopilot.set_rc(9, LOW)
        texts += shown(run_for(flight, 1.5))
    assert [text for text in texts if "vine sensor" in text] == [
        "Vine: vine sensor reads 1e+30 kPa, vented",
        "Vine: cleared: vine sensor reads 1e+30 kPa",
        "Vine: vine sensor reads 1e+30 kPa, vented (unstable: 2 losses in 2 s)",
    ]


@pytest.mark.parametrize(
    "values",
    [
        {"device_time_ms": 0xFFFFFFFF},
        {"device_time_ms": 0},
        {"faults": 0xFFFF},
        {"number": 0xFFFF},
        {"mode": Mode.FAULT},
        {"evp_opening": 1.0, "dvp_opening": 1.0, "solenoid": False},
        {"setpoint_kPa": 474.0, "cv_kPa": -54.0, "reservoir_kPa": 2262.0},
    ],
)
@pytest.mark.parametrize("frames", [pytest.param(1, marks=pytest.mark.long), 50])
def test_with_any_other_value_in_a_frame_the_flight_continues_or_the_vine_is_vented(
    frames: int, values: dict[str, float]
) -> None:
    flight = bent()
    Spoiled(flight).spoil_next(frames, values)
    run_for(flight, 3.0)
    assert flight.core.internal_error is False
    if flight.core.snapshot(flight.world.now).doing == "vented":
        assert_vented(flight)


def test_possible_readings_never_damage_an_estimate() -> None:
    prior = nominal(config.default().pneumatics)
    for seed in range(8):
        reader, reservoir = TelemetryReader(prior), ReservoirEstimate(prior)
        checks = PhysicsChecks(prior, config.default().checks)
        for i, (t, telemetry) in enumerate(hostile(random.Random(seed))):
            features = reader.read(t, telemetry)
            reservoir.update(features)
            checks.take(features)
            assert math.isfinite(reservoir.spending_kPa(20.0))
            if i % 8:
                continue  # a prediction takes milliseconds and changes nothing
            if (left := reservoir.cycles_left()) is not None:
                assert 0.0 <= left.low <= left.expected <= left.high < math.inf
            if reservoir.filter is not None:
                assert all(reservoir.filter.covariance[i][i] >= 0.0 for i in range(9))


def hostile(chance: random.Random) -> Iterator[tuple[float, Telemetry]]:
    """Random possible readings, in jumps."""
    t, holds = 0.0, chance.choice([1, 3, 20, 100, 400])
    (cv_low, cv_high), (low, high) = PLAUSIBLE_KPA["cv_kPa"], PLAUSIBLE_KPA["reservoir_kPa"]
    values: dict[str, float] = {}
    for i in range(800):
        if i % holds == 0:
            values = {
                "setpoint_kPa": chance.choice([0.0, chance.uniform(0.0, 60.0)]),
                "cv_kPa": chance.choice([chance.uniform(cv_low, cv_high), cv_low, cv_high, 0.0, 20.0]),
                "reservoir_kPa": chance.choice([chance.uniform(low, high), low, high, -101.325, 690.0]),
                "evp_opening": chance.choice([0.0, 1.0, chance.random()]),
                "dvp_opening": chance.choice([0.0, 0.0, 1.0]),
                "solenoid": chance.random() < 0.5,
            }
        t += chance.choice([0.01] * 20 + [0.0, 0.1, 0.3, 3.0, 11.0, 100.0])
        mode = chance.choice(list(Mode))
        yield t, Telemetry(int(t * 1e3), mode, Fault.NONE, 0, **values)  # type: ignore[arg-type]
