"""The RC receiver: sticks, what a ground station says instead, and what the autopilot sees of both."""

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
"""What a loss can look like; the first one is the usual one."""

CHANNELS = 16
THROTTLE = 3
_AT_REST_US = (1500, 1500, 1000, 1500, 1800, 1000, 1000, 1000, 1000) + (1500,) * 7
_JUMP_US = (1500, 1500, 950) + (1500,) * 13
_UNCHANGED_US, _RELEASED_US = (0, 65535), 65534


class Receiver:
    """Sticks and overrides in, channel values out.

    `values_us` is what the autopilot has: the sticks; while lost the last values ("frozen") or the receiver's
    own failsafe values ("jump"); nothing at all before the first pulse, or once it is "silent". Channels that
    a ground station overrides (RC_CHANNELS_OVERRIDE) have its values instead. On PX4 overrides are an RC
    input of their own, which is there while they come.
    """

    def __init__(self, kind: AutopilotKind, present: bool = True, source: RcSource | None = None) -> None:
        self.source: RcSource = source or ("pulses" if kind == "ardupilot" else "overrides")
        if (kind == "ardupilot") != (self.source == "pulses"):
            raise ValueError(f"{kind} has no receiver {self.source!r} here")
        self.sticks_us = list(_AT_REST_US)
        self.lost: RcLoss | None = None
        self.overridden = False
        self.updates = 0
        """Counts the overrides that came; PX4 tells its channels once for each."""
        self.has_rssi = True
        """CRSF tells the link's quality, but not in a loss."""
        self._received_us: tuple[int, ...] = tuple(self.sticks_us)
        self._overrides_us: dict[int, int] = {}
        if not present or self.source == "joystick":
            self.lost = LOSSES[self.source][0]
            self._received_us = ()

    @property
    def values_us(self) -> tuple[int, ...]:
        """Channel 1 first; empty while there are none."""
        received_us = () if self.lost == "silent" else self._received_us
        if not self._overrides_us:
            return received_us
        values_us = list(received_us or _AT_REST_US)
        for index, us in self._overrides_us.items():
            values_us[index] = us
        return tuple(values_us)

    def move(self, channel: int, us: int) -> None:
        """Move a stick or switch; seen at once if the link stands, on its return otherwise."""
        if not 1 <= channel <= CHANNELS:
            raise ValueError(f"RC channel must be 1 to {CHANNELS}, not {channel}")
        if not 0 <= us <= 65535:
            raise ValueError(f"RC value must be 0 to 65535 us, not {us}")
        self.sticks_us[channel - 1] = us
        if self.lost is None:
            self._received_us = tuple(self.sticks_us)

    def override(self, channels_us: Sequence[int]) -> None:
        """What a ground station sends in RC_CHANNELS_OVERRIDE, channel 1 first."""
        for index, us in enumerate(channels_us[:CHANNELS]):
            if us == _RELEASED_US:
                self._overrides_us.pop(index, None)
            elif us not in _UNCHANGED_US:
                self._overrides_us[index] = us
        self.overridden = bool(self._overrides_us)
        self.updates += 1

    def release(self) -> None:
        """No override holds any longer."""
        self._overrides_us.clear()
        self.overridden = False

    def lose(self, how: RcLoss, preset: Mapping[int, int] | None) -> None:
        """The link is lost. In a "jump" the channels of `preset` have these values, the others stay."""
        self.lost = how
        if how == "jump" and preset is None:
            self._received_us = _JUMP_US
        elif how == "jump" and preset is not None:
            values_us = enumerate(self._received_us, start=1)
            self._received_us = tuple(preset.get(channel, us) for channel, us in values_us)

    @property
    def throttle_us(self) -> int:
        """As received; 0 where nothing ever was."""
        return self._received_us[THROTTLE - 1] if self._received_us else 0

    def restore(self) -> None:
        self.lost = None
        self._received_us = tuple(self.sticks_us)

    def reboot(self) -> None:
        """The autopilot forgets what it has seen."""
        self.release()
        if self.lost != "jump":
            self._received_us = () if self.lost else tuple(self.sticks_us)
