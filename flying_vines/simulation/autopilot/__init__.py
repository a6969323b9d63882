"""A fake ArduPilot or PX4 copter that speaks MAVLink, without IO.

    autopilot = Autopilot("ardupilot", mission=read_waypoints("bridge.waypoints"))
    autopilot.start_mission()
    while flying:
        autopilot.receive(t, "companion", what_the_companion_sent)
        for link, frame in autopilot.advance(t):
            ...

It behaves as the real ones were recorded to, traps included: see the recordings that its tests replay.
"""

from flying_vines.simulation.autopilot.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot.receiver import RcLoss, RcSource
from flying_vines.vehicle.mission.storage import AutopilotKind, MissionRefused

__all__ = ["AutopilotKind", "FakeAutopilot", "MissionRefused", "RcLoss", "RcSource"]
