"""A simulated ArduPilot or PX4 copter with MAVLink, without I/O.

    autopilot = FakeAutopilot("ardupilot", mission=read_waypoints("bridge.waypoints"))
    autopilot.start_mission()
    while flying:
        autopilot.receive(t, "companion", what_the_companion_sent)
        for link, frame in autopilot.advance(t):
            ...

It behaves as real autopilots did in recordings, including their quirks. Its tests replay these recordings.
"""

from flying_vines.simulation.autopilot.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot.rc_input import RcLoss, RcSource
from flying_vines.vehicle.mission.item import AutopilotKind, MissionRefused

__all__ = ["AutopilotKind", "FakeAutopilot", "MissionRefused", "RcLoss", "RcSource"]
