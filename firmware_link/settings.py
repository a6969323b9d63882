"""What is set in the firmware: read in full, and changed by name. No port, no clock."""

from __future__ import annotations

import difflib
import struct
from collections.abc import Mapping

from firmware_link.protocol import GetSetting, HostMessage, Message, Refusal, SetSetting, Setting

_ASK_AGAIN_S = 0.2
_MOST_TRIES = 10


class SettingsTalk:
    """Asks for one setting after another until all are known, then makes `changes` (by name).

    Send what `due` returns whenever the session is READY; it asks again for what does not come. Finished once
    `done` or `problem`; nothing is changed unless every change is a setting of this firmware's, and within
    its range.
    """

    def __init__(self, changes: Mapping[str, float] | None = None) -> None:
        self.settings: list[Setting] = []
        """In the firmware's order, as far as they are known; with the changes that it has confirmed."""
        self.problem = ""
        """A sentence: what went wrong, which ends the talk."""
        self._changes = dict(changes or {})
        self._complete = False
        self._asked_s: float | None = None
        self._tries = 0

    @property
    def done(self) -> bool:
        return self._complete and not self._changes

    def due(self, t: float) -> list[HostMessage]:
        """What is to be asked at `t`."""
        if self.done or self.problem:
            return []
        if self._asked_s is not None and t - self._asked_s < _ASK_AGAIN_S:
            return []
        if self._tries == _MOST_TRIES:
            self.problem = "the firmware does not answer about its settings"
            return []
        self._asked_s = t
        self._tries += 1
        if not self._complete:
            return [GetSetting(len(self.settings))]
        name, value = next(iter(self._changes.items()))
        return [SetSetting(self._named(name).id, value)]

    def receive(self, message: Message) -> None:
        """Any message of the firmware's."""
        if self.done or self.problem:
            return
        match message:
            case Setting() if not self._complete and message.id == len(self.settings):
                self.settings.append(message)
                self._complete = len(self.settings) >= message.count
                self._go_on()
                if self._complete:
                    self.problem = self._why_not()
            case Setting() if self._complete and message.id < len(self.settings):
                self.settings[message.id] = message
                if self._changes.get(message.name, message.value) == message.value:
                    self._changes.pop(message.name, None)
                    self._go_on()
            case Refusal(0, reason) if self._asked_s is not None:
                what = f"to set {next(iter(self._changes))}" if self._complete else "to tell its settings"
                self.problem = f"the firmware refuses {what}: {reason.name.lower().replace('_', ' ')}"

    def _go_on(self) -> None:
        self._asked_s = None
        self._tries = 0

    def _named(self, name: str) -> Setting:
        return next(setting for setting in self.settings if setting.name == name)

    def _why_not(self) -> str:
        """What of the changes this firmware cannot do; they are rounded to its floats on the way."""
        names = [setting.name for setting in self.settings]
        for name, value in self._changes.items():
            if name not in names:
                near = difflib.get_close_matches(name, names, n=1)
                hint = f"; did you mean {near[0]}?" if near else f": it has {', '.join(names)}"
                return f"this firmware has no setting {name}{hint}"
            setting = self._named(name)
            # Written so that NaN is never within.
            if not setting.least <= value <= setting.most:
                return f"{name} is from {setting.least:g} to {setting.most:g}, not {value:g}"
            self._changes[name] = struct.unpack("<f", struct.pack("<f", value))[0]
        return ""
