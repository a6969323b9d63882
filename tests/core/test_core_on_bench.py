"""Bench mode: a person tries the vine on the ground; and the events that end the mode."""

from __future__ import annotations

import msgspec
import pytest

from flying_vines.config import config
from flying_vines.core import core
from flying_vines.core.events import Asked, Decision
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vine.intent import BendTo, Intent, SetPressure, StartBench, StopBench

from .flights import notices, on_the_ground, run_for


def ask(flight: SimulatedFlight, intent: Intent) -> Decision:
    (decision,) = (a for a in flight.feed(Asked(flight.world.now, "page", intent)) if isinstance(a, Decision))
    return decision


def bent_on_the_bench() -> SimulatedFlight:
    flight = on_the_ground()
    assert ask(flight, StartBench()).safety == "accepted"
    assert ask(flight, BendTo(30.0)).safety == "accepted"
    run_for(flight, 1.5)
    assert flight.phlosar.cv_kPa > 8.0
    return flight


def vented(flight: SimulatedFlight) -> bool:
    return flight.phlosar.cv_kPa < 1.0 and flight.core.snapshot(flight.world.now).doing == "vented"


def test_on_the_ground_nothing_bends_without_bench_mode() -> None:
    flight = on_the_ground()
    refused = ask(flight, SetPressure(5.0))
    assert (refused.safety, refused.reason) == ("refused", "the page can bend the vine only in bench mode")


def test_bench_mode_is_refused_while_the_vehicle_is_armed() -> None:
    flight = on_the_ground()
    flight.autopilot.takeoff(5.0)
    run_for(flight, 1.0)
    refused = ask(flight, StartBench())
    assert (refused.safety, refused.reason) == ("refused", "the vehicle is armed")


def test_arming_ends_bench_mode_and_vents() -> None:
    flight = bent_on_the_bench()
    flight.autopilot.takeoff(5.0)
    texts = notices(run_for(flight, 2.0))
    assert "Vine: bench mode over, the vehicle is armed: vented" in texts
    assert vented(flight)


def test_bench_mode_ends_on_request() -> None:
    flight = bent_on_the_bench()
    assert ask(flight, StopBench()).safety == "accepted"
    assert flight.core.snapshot(flight.world.now).waiting is None
    run_for(flight, 1.0)
    assert vented(flight)
    assert ask(flight, BendTo(30.0)).safety == "refused"


def test_bench_mode_ends_without_further_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(core, "BENCH_S", 4.0)
    flight = on_the_ground()
    ask(flight, StartBench())
    run_for(flight, 3.0)
    assert ask(flight, BendTo(30.0)).safety == "accepted"
    assert not any("bench mode over" in text for text in notices(run_for(flight, 3.5)))
    assert flight.core.snapshot(flight.world.now).bench
    texts = notices(run_for(flight, 1.5))
    assert "Vine: bench mode over, no more requests: vented" in texts
    assert vented(flight)


@pytest.mark.parametrize("how", ["frozen", "jump"])
def test_rc_that_is_switched_off_vents_and_is_not_reported_as_back(how: str) -> None:
    flight = bent_on_the_bench()
    flight.autopilot.lose_rc(how)  # type: ignore[arg-type]
    texts = notices(run_for(flight, 3.0))
    assert any("RC lost" in text for text in texts)
    assert "Vine: RC is off and not in use" in texts
    assert not any("RC is back" in text for text in texts)
    assert vented(flight)
    assert ask(flight, BendTo(30.0)).safety == "accepted", "without RC the page may bend on the bench"


def test_only_a_request_of_a_person_prolongs_bench_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(core, "BENCH_S", 4.0)
    flight = on_the_ground()
    ask(flight, StartBench())
    run_for(flight, 3.0)
    t = flight.world.now
    item = Trigger(t, "mission_item", {"seq": 3, "command": 31010}, BendTo(30.0))
    assert flight.core._decide(t, item).safety == "accepted"
    assert "Vine: bench mode over, no more requests: vented" in notices(run_for(flight, 1.5))


def test_rc_that_is_switched_off_vents_with_a_bench_configuration() -> None:
    interlocks = config.InterlocksConfig(bench_mode=True)
    flight = on_the_ground(msgspec.structs.replace(config.default(), interlocks=interlocks))
    assert ask(flight, BendTo(30.0)).safety == "accepted"
    run_for(flight, 1.5)
    assert flight.phlosar.cv_kPa > 8.0
    flight.autopilot.lose_rc("jump")
    actions = run_for(flight, 2.0)
    assert any("RC lost" in text for text in notices(actions))
    assert {"loss": "rc"} in [a.what for a in actions if isinstance(a, Decision)]
    assert vented(flight)


def test_on_the_ground_a_loss_decides_nothing_for_a_vented_vine() -> None:
    flight = on_the_ground()
    flight.phlosar.reset_firmware()
    actions = run_for(flight, 1.0)
    assert any("restarted" in text for text in notices(actions))
    assert [a for a in actions if isinstance(a, Decision)] == []
