"""Compares the mode that the board reports with the commanded one."""

from __future__ import annotations

from firmware_link.protocol import Mode


class BoardMode:
    """Call `note` for each telemetry message."""

    def __init__(self) -> None:
        self._commanded: Mode | None = None
        """The command that the board does not follow; None if it follows."""
        self._began_at = self._ended_at = 0.0

    def restart(self) -> None:
        self._commanded = None

    def note(self, made_at: float, mode: Mode, commanded: Mode) -> None:
        """The board was in `mode` when it made a message, at `made_at` on our clock.

        A board in FAULT mode vents, so FAULT is also right after a VENT command.
        """
        if mode is commanded or (mode is Mode.FAULT and commanded is Mode.VENT):
            self._commanded = None
            return
        if self._commanded is not commanded:
            self._commanded, self._began_at = commanded, made_at
        self._ended_at = made_at

    def mismatch_s(self, commanded: Mode) -> float:
        """The time for which the board has not followed this command; 0 if it follows."""
        return self._ended_at - self._began_at if self._commanded is commanded else 0.0
