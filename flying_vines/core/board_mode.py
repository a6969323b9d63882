"""Compares the mode, the valves and the setpoint that the board reports with the commanded ones."""

from __future__ import annotations

from collections import deque

from firmware_link.protocol import Mode, Telemetry

FORGIVES = 0.25
"""A second in which the board follows outweighs so many seconds in which it did not."""
MOST_WRONG_S = 0.4
"""Above the allowed 0.3 s, so that a board counts as obedient again after a second."""
SETPOINT_DELAY_S = 0.3
"""The board follows each setpoint within this time, even if eleven commands in a row are lost."""
SETPOINT_FOLLOWS_WITHIN_S = 1.0
TOLERATED_KPA = 1.0


class BoardMode:
    """Call `note` for each telemetry message.

    A message that agrees does not refute the others: a board that says VENT in every second message, or only
    now and then, regulates.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        self._commanded: Mode | None = None
        self._noted_at = self._wrong_s = 0.0

    def note(self, t: float, made_at: float, telemetry: Telemetry, commanded: Mode) -> None:
        """The board made this message at `made_at` on our clock; it is read at `t`.

        After our process was stalled, messages from before the command are read after it.
        A board in FAULT mode vents, so FAULT is also right after a VENT command. A board vents only if it
        also says that its inflation valve is shut and its outlet open.
        """
        if commanded is not self._commanded:
            self._commanded, self._noted_at, self._wrong_s = commanded, t, 0.0
        passed_s = max(0.0, made_at - self._noted_at)
        self._noted_at += passed_s
        if commanded is Mode.VENT:
            shut = telemetry.solenoid and telemetry.evp_opening == 0.0
            follows = telemetry.mode is not Mode.REGULATE and shut
        else:
            follows = telemetry.mode is commanded
        wrong_s = self._wrong_s - FORGIVES * passed_s if follows else self._wrong_s + passed_s
        self._wrong_s = min(MOST_WRONG_S, max(0.0, wrong_s))

    def mismatch_s(self, commanded: Mode) -> float:
        """The time for which the board has not followed this command; 0 if it follows."""
        return self._wrong_s if self._commanded is commanded else 0.0


class BoardSetpoint:
    """Call `command` for each setpoint that is sent, `note` for each telemetry message in REGULATE.

    The board's setpoint starts at the vine's pressure and moves to the commanded one at the commanded rate.
    So it may be elsewhere as long as it moves there at half of this rate or faster.
    """

    def __init__(self) -> None:
        self._commanded: deque[tuple[float, float]] = deque()
        self.restart()

    def restart(self) -> None:
        """Nothing is commanded, or the board's state is not known."""
        self._commanded.clear()
        self._side = 0
        """1: the board's setpoint is too high; -1: too low; 0: it is right."""
        self._since = self._at_since_kPa = 0.0
        self.wrong: tuple[float, float] | None = None
        """The reported setpoint that contradicts the commanded one, and the latter."""

    def command(self, t: float, setpoint_kPa: float) -> None:
        commanded = self._commanded
        commanded.append((t, setpoint_kPa))
        # The last command before the delay was still in force.
        while len(commanded) > 1 and commanded[1][0] < t - SETPOINT_DELAY_S:
            commanded.popleft()

    def note(self, made_at: float, setpoint_kPa: float, rate_kPa_per_s: float) -> None:
        """The board had this setpoint at `made_at`; it may move at this rate."""
        if not self._commanded:
            return
        targets = [kPa for _, kPa in self._commanded]
        above_kPa, below_kPa = setpoint_kPa - max(targets), min(targets) - setpoint_kPa
        side = (above_kPa > TOLERATED_KPA) - (below_kPa > TOLERATED_KPA)
        if side != self._side or not side:
            self._side, self._since, self._at_since_kPa, self.wrong = side, made_at, setpoint_kPa, None
            return
        lasts_s = made_at - self._since
        if lasts_s < SETPOINT_FOLLOWS_WITHIN_S:
            return
        moved_kPa = side * (self._at_since_kPa - setpoint_kPa)
        follows = moved_kPa >= 0.5 * rate_kPa_per_s * lasts_s
        self.wrong = None if follows else (setpoint_kPa, targets[-1])
        if follows:
            self._since, self._at_since_kPa = made_at, setpoint_kPa
