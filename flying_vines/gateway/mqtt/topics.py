"""The MQTT topics of one vehicle. The vehicle's name in the topic separates the vehicles of a fleet."""

from __future__ import annotations

import re
import socket

from flying_vines.config.config import MqttConfig


class Topics:
    """The topics of one vehicle; all begin with `base`."""

    def __init__(self, prefix: str, name: str) -> None:
        self.prefix, self.name = prefix, name
        self.base = base = f"{prefix}/{name}"
        self.status = f"{base}/status"
        self.about = f"{base}/about"
        self.state = f"{base}/state"
        self.reservoir = f"{base}/reservoir"
        self.event = f"{base}/event"
        self.ask = f"{base}/ask"
        self.answer = f"{base}/answer"

    @classmethod
    def of(cls, mqtt: MqttConfig) -> Topics:
        """A vehicle without a name has the computer's name."""
        return cls(mqtt.prefix, mqtt.name or re.sub(r"[^\w.-]", "-", socket.gethostname(), flags=re.ASCII))
