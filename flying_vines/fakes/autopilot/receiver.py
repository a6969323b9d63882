"""The RC receiver: what the sticks say, and what the autopilot sees of it."""

from __future__ import annotations

from typing import Literal

RcLoss = Literal["frozen", "jump", "silent"]

CHANNELS = 16
_AT_REST_US = (1500, 1500, 1000, 1500, 1800, 1000, 1000, 1000, 1000) + (1500,) * 7
_JUMP_US = (1500, 1500, 950) + (1500,) * 13


class Receiver:
    """Sticks in, channel values out.

    `values_us` is what the autopilot has: the sticks; while lost the last values ("frozen", "silent") or the
    receiver's own failsafe values ("jump"); nothing at all before the first pulse.
    """

    def __init__(self, present: bool = True) -> None:
        self.sticks_us = list(_AT_REST_US)
        self.lost: RcLoss | None = None if present else "frozen"
        self.values_us: tuple[int, ...] = tuple(self.sticks_us) if present else ()

    def move(self, channel: int, us: int) -> None:
        """Move a stick or switch; seen at once if the link stands, on its return otherwise."""
        if not 1 <= channel <= CHANNELS:
            raise ValueError(f"RC channel must be 1 to {CHANNELS}, not {channel}")
        if not 0 <= us <= 65535:
            raise ValueError(f"RC value must be 0 to 65535 us, not {us}")
        self.sticks_us[channel - 1] = us
        if self.lost is None:
            self.values_us = tuple(self.sticks_us)

    def lose(self, how: RcLoss) -> None:
        self.lost = how
        if how == "jump":
            self.values_us = _JUMP_US

    def restore(self) -> None:
        self.lost = None
        self.values_us = tuple(self.sticks_us)

    def reboot(self) -> None:
        """The autopilot forgets what it has seen."""
        if self.lost != "jump":
            self.values_us = () if self.lost else tuple(self.sticks_us)
