"""The MQTT topics of one vehicle. The vehicle's name in the topic separates the vehicles of a fleet."""

from __future__ import annotations

import re
import socket
from dataclasses import dataclass

from flying_vines.config.config import MqttConfig


@dataclass(frozen=True, slots=True)
class Topics:
    """The topics of one vehicle; all begin with `base`."""

    prefix: str
    name: str

    @classmethod
    def of(cls, mqtt: MqttConfig) -> Topics:
        """A vehicle without a name has the computer's name."""
        return cls(mqtt.prefix, mqtt.name or re.sub(r"[^\w.-]", "-", socket.gethostname(), flags=re.ASCII))

    @property
    def base(self) -> str:
        return f"{self.prefix}/{self.name}"

    @property
    def status(self) -> str:
        return f"{self.base}/status"

    @property
    def about(self) -> str:
        return f"{self.base}/about"

    @property
    def state(self) -> str:
        return f"{self.base}/state"

    @property
    def reservoir(self) -> str:
        return f"{self.base}/reservoir"

    @property
    def event(self) -> str:
        return f"{self.base}/event"

    @property
    def ask(self) -> str:
        return f"{self.base}/ask"

    @property
    def answer(self) -> str:
        return f"{self.base}/answer"
