"""Reads all settings of the firmware, and changes some by name. It opens no port and reads no clock."""

from __future__ import annotations

import difflib
import struct
from collections.abc import Iterable, Mapping

from firmware_link.protocol import GetSetting, HostMessage, Message, Refusal, SetSetting, Setting

_REQUEST_AGAIN_S = 0.2
_MAX_TRIES = 10
_WHOLE = ("dead_man_ms", "telemetry_Hz")
"""Settings that the firmware stores as whole numbers, as `Welcome` has them. It would cut off a fraction."""


def digest(settings: Iterable[Setting]) -> int:
    """The digest of all settings, in the firmware's order, as in `Welcome`: FNV-1a of their 32-bit floats."""
    digest = 0x811C9DC5
    for byte in b"".join(struct.pack("<f", setting.value) for setting in settings):
        digest = (digest ^ byte) * 0x01000193 & 0xFFFFFFFF
    return digest


class SettingsExchange:
    """Requests one setting after another until all are known, then makes `changes` (by name).

    Send the messages of `due` whenever the session is READY. Unanswered requests are repeated. The exchange
    is finished when `done` or `problem` is set. If one of the changes is unknown or its value is not allowed,
    none is made.
    """

    def __init__(self, changes: Mapping[str, float] | None = None) -> None:
        self.settings: list[Setting] = []
        """The known settings, in the firmware's order, with confirmed changes."""
        self.before: tuple[Setting, ...] = ()
        """All settings before the changes."""
        self.problem = ""
        """The error that ended the exchange, as a sentence; empty without an error."""
        self._changes = dict(changes or {})
        self._complete = False
        self._requested_s: float | None = None
        self._tries = 0

    @property
    def done(self) -> bool:
        return self._complete and not self._changes

    def due(self, t: float) -> list[HostMessage]:
        """The messages to send at `t`."""
        if self.done or self.problem:
            return []
        if self._requested_s is not None and t - self._requested_s < _REQUEST_AGAIN_S:
            return []
        if self._tries == _MAX_TRIES:
            self.problem = "the firmware does not answer requests for settings"
            return []
        self._requested_s = t
        self._tries += 1
        if not self._complete:
            return [GetSetting(len(self.settings))]
        name, value = next(iter(self._changes.items()))
        return [SetSetting(self._named(name).id, value)]

    def receive(self, message: Message) -> None:
        """Handle any message of the firmware."""
        if self.done or self.problem:
            return
        match message:
            case Setting() if not self._complete and message.id == len(self.settings):
                self.settings.append(message)
                self._complete = len(self.settings) >= message.count
                self._answered()
                if self._complete:
                    self.before = tuple(self.settings)
                    self.problem = self._check_changes()
            case Setting() if self._complete and message.id < len(self.settings):
                self.settings[message.id] = message
                if self._changes.get(message.name, message.value) == message.value:
                    self._changes.pop(message.name, None)
                    self._answered()
            case Refusal(0, reason) if self._requested_s is not None:
                what = f"to set {next(iter(self._changes))}" if self._complete else "to report its settings"
                self.problem = f"the firmware refuses {what}: {reason.name.lower().replace('_', ' ')}"

    def _answered(self) -> None:
        self._requested_s = None
        self._tries = 0

    def _named(self, name: str) -> Setting:
        return next(setting for setting in self.settings if setting.name == name)

    def _check_changes(self) -> str:
        """The reason why this firmware cannot make one of the changes; else empty.

        Rounds the new values to 32-bit floats.
        """
        names = [setting.name for setting in self.settings]
        for name, value in self._changes.items():
            if name not in names:
                near = difflib.get_close_matches(name, names, n=1)
                hint = f"; did you mean {near[0]}?" if near else f": it has {', '.join(names)}"
                return f"this firmware has no setting {name}{hint}"
            setting = self._named(name)
            # Written so that NaN is refused, too.
            if not setting.least <= value <= setting.most:
                return f"{name} must be from {setting.least:g} to {setting.most:g}, not {value:g}"
            (self._changes[name],) = struct.unpack("<f", struct.pack("<f", value))
            if name in _WHOLE and not self._changes[name].is_integer():
                return f"{name} must be a whole number, not {value}"
        return ""
