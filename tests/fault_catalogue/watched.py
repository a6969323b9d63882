"""A flight in simulated time with recorded valves, and the texts that its pilot reads."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.core.events import Action, Decision, Event, ToVehicle, VehicleMessage
from flying_vines.physics.plant.effects import Effects
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mission.item import AutopilotKind

from .black_box import STEP_S, BlackBox

SWITCH = 9
LOW, MIDDLE, HIGH = 1000, 1500, 2000
CRUISE_M = 10.0
RESTED_S = 4.4
"""Time after the take-off until the vine may surely bend."""
HALF_BENT_KPA = 11.35


class Texts:
    """Assembles status texts from their chunks, like a ground station."""

    def __init__(self) -> None:
        self.read: list[str] = []
        self._parts: dict[int, str] = {}

    def take(self, action: Action) -> None:
        if not isinstance(action, ToVehicle) or action.message.get_type() != "STATUSTEXT":
            return
        message = action.message
        if message.id == 0:
            self.read.append(message.text)
            return
        text = self._parts.pop(message.id, "") + message.text
        if len(message.text) < 50:
            self.read.append(text)
        else:
            self._parts[message.id] = text


class Watched:
    """A flight with a straight vine. It advances by milliseconds, so that no valve command is missed.

    The switch bends and straightens the vine. On a flight without RC, a button of the ground station does.
    """

    def __init__(
        self,
        kind: AutopilotKind = "ardupilot",
        tables: Mapping[str, object] | None = None,
        rc: bool = True,
        reservoir_kPa: float = 690.0,
        rested_s: float = RESTED_S,
    ) -> None:
        conf = msgspec.structs.replace(config.default(), **(tables or {}))
        self._has_rc = rc
        self._ground = MavlinkCodec(255, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._companion = MavlinkCodec(conf.vehicle.system_id, conf.vehicle.component_id)
        self.autopilot = FakeAutopilot(kind, rc_present=rc, rc_failsafe_mode=None)
        self.autopilot.set_rc(SWITCH, LOW)
        self.phlosar = SimulatedPhlosar(effects=Effects(), reservoir_kPa=reservoir_kPa)
        self.box = BlackBox(self.phlosar)
        self.flight = SimulatedFlight(conf, self.autopilot, self.phlosar)
        self.texts = Texts()
        self.decisions: list[Decision] = []
        self.run(1.2)
        self.take_off()
        self.run(rested_s)

    @property
    def now_s(self) -> float:
        return self.flight.world.now

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.take(self.flight.run(self.now_s + STEP_S, STEP_S))
            self.box.look()

    def feed(self, event: Event) -> None:
        self.take(self.flight.feed(event))

    def take(self, actions: list[Action]) -> None:
        for action in actions:
            self.texts.take(action)
            if isinstance(action, Decision):
                self.decisions.append(action)

    def take_off(self) -> None:
        self.autopilot.takeoff(CRUISE_M)

    def straighten(self) -> None:
        self._ask(LOW, 0)

    def bend_half(self) -> None:
        self._ask(MIDDLE, 4)

    def bend_full(self) -> None:
        self._ask(HIGH, 5)

    def _ask(self, pulse_us: int, button: int) -> None:
        if self._has_rc:
            self.autopilot.set_rc(SWITCH, pulse_us)
        else:
            self.ask_by_command(button)

    def ask_by_command(self, button: int) -> None:
        """A ground station sends USER_1."""
        command = mavlink.MAVLink_command_long_message(1, 191, mavlink.MAV_CMD_USER_1, 0, button, *[0.0] * 6)
        for message in self._companion.decode(self._ground.encode(command, 255)):
            self.feed(VehicleMessage(self.now_s, message))

    def forget(self) -> None:
        """Forget earlier texts and decisions."""
        self.texts.read.clear()
        self.decisions.clear()

    def has_text(self, text: str) -> bool:
        return any(text in read for read in self.texts.read)

    def describe(self) -> str:
        """The texts and decisions, for a failing test."""
        return "\n".join([*self.texts.read, *(str(dataclasses.asdict(d)) for d in self.decisions)])
