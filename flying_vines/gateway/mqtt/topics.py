"""Where on a broker each thing of one vehicle is. Fleets are told apart by the name in the topic."""

from __future__ import annotations

import re
import socket
from dataclasses import dataclass

from flying_vines.config.config import MqttConfig


@dataclass(frozen=True, slots=True)
class Topics:
    """Of one vehicle; `base` is what they begin with."""

    prefix: str
    name: str

    @classmethod
    def of(cls, mqtt: MqttConfig) -> Topics:
        """A vehicle that has no name goes by that of its computer."""
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
