"""Two autopilots on one link without a configured system id."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.core.events import VehicleMessage
from flying_vines.physics.plant.effects import Effects
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec

from .black_box import BlackBox
from .catalogue import ROWS
from .watched import HIGH, LOW, SWITCH, Texts


def test_two_autopilots() -> None:
    autopilot = FakeAutopilot("ardupilot")
    autopilot.set_rc(SWITCH, LOW)
    phlosar = SimulatedPhlosar(effects=Effects())
    box = BlackBox(phlosar)
    flight = SimulatedFlight(config.default(), autopilot, phlosar)
    texts = Texts()
    for i in range(60):
        for action in flight.run(flight.world.now + 0.1):
            texts.take(action)
        for action in flight.feed(VehicleMessage(flight.world.now, heartbeat_of(2))):
            texts.take(action)
        if i == 30:
            autopilot.set_rc(SWITCH, HIGH)
            autopilot.takeoff(10.0)
    assert any(ROWS["two_autopilots"].pilot_text in text for text in texts.read)
    assert box.unsafe_s is None


def heartbeat_of(system: int) -> mavlink.MAVLink_message:
    message = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )
    sent = MavlinkCodec(system, mavlink.MAV_COMP_ID_AUTOPILOT1).encode(message, system)
    (received,) = MavlinkCodec(1, 191).decode(sent)
    return received
