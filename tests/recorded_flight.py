"""Flights in simulated time with a recorder, as in the service."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flying_vines.config import config
from flying_vines.core.core import Core
from flying_vines.core.events import Action, Event, ToVehicle
from flying_vines.record.recorder import FlightStart, Recorder
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec

SWITCH, LOW, MIDDLE, HIGH = 9, 1000, 1500, 2000
TEXT = config.default_text().replace("bench_mode = false", "bench_mode = true")
CONFIG = config.parse(TEXT, "the test's configuration")
BEGAN = FlightStart(TEXT, CONFIG.pneumatics)


def watch(core: Core, recorder: Recorder) -> None:
    """Let the recorder see the core's events and actions."""
    handle, codec = core.handle, MavlinkCodec(0, 191)

    def handled(event: Event) -> list[Action]:
        actions = handle(event)
        for action in actions:
            if isinstance(action, ToVehicle):
                codec.encode(action.message, action.system_id)
        recorder.event(event)
        for action in actions:
            recorder.action(action)
        return actions

    core.handle = handled  # type: ignore[method-assign]


def fly(
    flight: SimulatedFlight, recorder: Recorder, moves: Sequence[tuple[float, int]], step_s: float = 0.1
) -> None:
    """Fly moves of the switch, each with a position and an end time, with snapshots as in the service."""
    watch(flight.core, recorder)
    now = flight.world.now
    for until_s, pulse_us in moves:
        flight.autopilot.set_rc(SWITCH, pulse_us)
        while now < until_s - 1e-9:
            now = min(until_s, now + step_s)
            flight.run(now)
            recorder.snapshot(flight.core.snapshot(now))


def new_flight(telemetry_Hz: int = 100) -> SimulatedFlight:
    phlosar = SimulatedPhlosar(firmware={"telemetry_Hz": telemetry_Hz})
    return SimulatedFlight(CONFIG, FakeAutopilot("ardupilot"), phlosar)


def one_bend(parent: Path) -> Path:
    """The folder of a flight of eight seconds."""
    recorder = Recorder(parent, BEGAN, t=0.0)
    fly(new_flight(), recorder, ((3.0, LOW), (5.5, HIGH), (8.0, LOW)))
    recorder.close()
    assert not recorder.failed
    return recorder.folder
