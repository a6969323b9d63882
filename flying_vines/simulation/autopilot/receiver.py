"""The RC receiver: sticks, overrides by a ground station, and the resulting channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from flying_vines.vehicle.mission.storage import AutopilotKind

RcLoss = Literal["frozen", "jump", "silent"]
RcSource = Literal["pulses", "sbus", "crsf", "overrides", "joystick"]
"""How the pilot's sticks reach the autopilot.

pulses: a receiver on ArduPilot. sbus, crsf: a receiver on PX4's driver of that name. overrides: PX4 gets
RC_CHANNELS_OVERRIDE from a ground station. joystick: PX4 gets MANUAL_CONTROL and has no RC_CHANNELS.
"""

LOSSES: dict[RcSource, tuple[RcLoss, ...]] = {
    "pulses": ("frozen", "jump"),
    "sbus": ("frozen", "jump"),
    "crsf": ("frozen",),
    "overrides": ("silent",),
    "joystick": ("silent",),
}
"""Possible kinds of loss; the first one is the default."""

CHANNELS = 16
THROTTLE = 3
_AT_REST_US = (1500, 1500, 1000, 1500, 1800, 1000, 1000, 1000, 1000) + (1500,) * 7
_JUMP_US = (1500, 1500, 950) + (1500,) * 13
_UNCHANGED_US, _RELEASED_US = (0, 65535), 65534


class Receiver:
    """Converts sticks and overrides to channel values.

    `values_us` are the autopilot's channels: the sticks; during a loss the last values ("frozen") or the
    receiver's failsafe values ("jump"); empty before the first pulse and in a "silent" loss. Channels that a
    ground station overrides (RC_CHANNELS_OVERRIDE) have the values of the override. PX4 with a receiver on
    its own driver ignores overrides (see `Px4Rc`).
    """

    def __init__(self, kind: AutopilotKind, present: bool = True, source: RcSource | None = None) -> None:
        self.source: RcSource = source or ("pulses" if kind == "ardupilot" else "overrides")
        if (kind == "ardupilot") != (self.source == "pulses"):
            raise ValueError(f"the simulated {kind} has no receiver {self.source!r}")
        self.sticks_us = list(_AT_REST_US)
        self.lost: RcLoss | None = None
        self.overridden = False
        self.updates = 0
        """Number of received overrides. While overridden, PX4 sends RC_CHANNELS at most once per override."""
        self.has_rssi = True
        """CRSF reports the link quality, but not during a loss."""
        self._received_us: tuple[int, ...] = tuple(self.sticks_us)
        self._overrides_us: dict[int, int] = {}
        if not present or self.source == "joystick":
            self.lost = LOSSES[self.source][0]
            self._received_us = ()

    @property
    def values_us(self) -> tuple[int, ...]:
        """The channels, from channel 1; empty if there are none."""
        received_us = () if self.lost == "silent" else self._received_us
        if not self._overrides_us:
            return received_us
        values_us = list(received_us or _AT_REST_US)
        for index, us in self._overrides_us.items():
            values_us[index] = us
        return tuple(values_us)

    def move(self, channel: int, us: int) -> None:
        """Move a stick or switch. During a loss the autopilot gets the new value when RC returns."""
        if not 1 <= channel <= CHANNELS:
            raise ValueError(f"RC channel must be 1 to {CHANNELS}, not {channel}")
        if not 0 <= us <= 65535:
            raise ValueError(f"RC value must be 0 to 65535 us, not {us}")
        self.sticks_us[channel - 1] = us
        if self.lost is None:
            self._received_us = tuple(self.sticks_us)

    def override(self, channels_us: Sequence[int]) -> None:
        """Apply RC_CHANNELS_OVERRIDE, from channel 1."""
        for index, us in enumerate(channels_us[:CHANNELS]):
            if us == _RELEASED_US:
                self._overrides_us.pop(index, None)
            elif us not in _UNCHANGED_US:
                self._overrides_us[index] = us
        self.overridden = bool(self._overrides_us)
        self.updates += 1

    def release(self) -> None:
        """End all overrides."""
        self._overrides_us.clear()
        self.overridden = False

    def lose(self, how: RcLoss, preset: Mapping[int, int] | None) -> None:
        """Lose the link.

        In a "jump" the channels of `preset` get its values, and the others stay. Without `preset` all
        channels get usual failsafe values.
        """
        self.lost = how
        if how == "jump" and preset is None:
            self._received_us = _JUMP_US
        elif how == "jump" and preset is not None:
            values_us = enumerate(self._received_us, start=1)
            self._received_us = tuple(preset.get(channel, us) for channel, us in values_us)

    @property
    def throttle_us(self) -> int:
        """The received throttle; 0 if nothing was received."""
        return self._received_us[THROTTLE - 1] if self._received_us else 0

    def restore(self) -> None:
        self.lost = None
        self._received_us = tuple(self.sticks_us)

    def reboot(self) -> None:
        """The autopilot reboots and forgets received values."""
        self.release()
        if self.lost != "jump":
            self._received_us = () if self.lost else tuple(self.sticks_us)
