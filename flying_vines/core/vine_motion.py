"""The vine's present motion, and the commands to the board that carry it out.

Without a motion the board is commanded to vent. It must report the mode and the setpoint that it is told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from firmware_link import host as fw
from firmware_link import protocol
from flying_vines.config.config import Config
from flying_vines.core.board_mode import BoardMode, BoardSetpoint
from flying_vines.core.motion_planner import MotionPlanner
from flying_vines.vine.intent import Intent, SetPressure
from flying_vines.vine.motion import Motion

STRAIGHTENS_WITHIN_S = 10.0
"""A vine of 2 L needs 5 s without the Venturi. Later the device is told to vent."""
NEAR_ZERO_KPA = 1.0


class VineMotion:
    """Pressures are gauge. `firmware` gets every command; the caller sends the messages that it returns."""

    def __init__(self, config: Config, firmware: fw.HostSession, tick_s: float) -> None:
        self.motion: Motion | None = None
        self.bent_kPa = 0.0
        """The pressure that gives the present bend during inflation (`BendCurve.bent_kPa`)."""
        self.triggered_at = 0.0
        """When the present motion was last requested. A hold by safety is no request."""
        self.firmware_limit_kPa = math.inf
        self._firmware = firmware
        self._tick_s = tick_s
        self._board_mode = BoardMode()
        self._board_setpoint = BoardSetpoint()
        self.configure(config)

    def configure(self, config: Config) -> None:
        self.planner = MotionPlanner(config)
        self._max_kPa = config.limits.max_kPa

    @property
    def only_deflates(self) -> bool:
        return self.motion is None or self.motion.only_deflates

    @property
    def near_zero(self) -> bool:
        """False only if telemetry shows pressure in the vine."""
        telemetry = self._firmware.telemetry
        return telemetry is None or telemetry.cv_kPa < NEAR_ZERO_KPA

    @property
    def vented(self) -> bool:
        return self.motion is None and self.near_zero

    @property
    def bend_deg(self) -> float:
        return self.planner.curve.angle_deg(self.bent_kPa)

    def commanded_kPa(self, t: float) -> float:
        return self.motion.setpoint_kPa(t) if self.motion else 0.0

    def setpoint_kPa(self, t: float) -> float:
        """The present setpoint; without a motion, the measured pressure."""
        if self.motion is not None:
            return self.motion.setpoint_kPa(t)
        telemetry = self._firmware.telemetry
        limit_kPa = min(self._max_kPa, self.firmware_limit_kPa)
        return min(max(0.0, telemetry.cv_kPa), limit_kPa) if telemetry else 0.0

    def plan(self, t: float, intent: Intent, rate_scale: float = 1.0) -> Motion:
        """The motion from the present setpoint."""
        start_kPa, limit_kPa = self.setpoint_kPa(t), self.firmware_limit_kPa
        return self.planner.plan(intent, start_kPa, self.bent_kPa, limit_kPa, rate_scale, started_at=t)

    def freeze(self, t: float) -> None:
        """Stay at the present setpoint."""
        self.motion = replace(self.plan(t, SetPressure(self.setpoint_kPa(t))), name="hold")

    def ended(self, t: float) -> Motion | None:
        """The motion if it has just straightened the vine, or should have. Then it is over: vented."""
        motion = self.motion
        if motion is None or not motion.is_over(t) or motion.final_kPa > 0.0:
            return None
        if not motion.is_over(t - STRAIGHTENS_WITHIN_S) and not self.near_zero:
            return None
        self.motion = None
        return motion

    def stop(self, t: float) -> Sequence[protocol.HostMessage]:
        self.motion = None
        return self.command(t)

    def command(self, t: float) -> Sequence[protocol.HostMessage]:
        """The command for the time until the next tick."""
        command: fw.HostCommand = fw.VENTING
        if self.motion is not None:
            command = fw.Regulate(self.motion.setpoint_kPa(t + self._tick_s), self.motion.rate_kPa_per_s)
            self._board_setpoint.command(t, command.target_kPa)
        return self._firmware.command(t, command)

    # The board's answer.

    def restart(self) -> None:
        """The board's state is not known."""
        self._board_mode.restart()
        self._board_setpoint.restart()

    def note(self, t: float, made_at: float, telemetry: protocol.Telemetry) -> None:
        """Compare what the board reports, made at `made_at` on our clock, with the command."""
        self._board_mode.note(t, made_at, telemetry, self._commanded_mode)
        if self.motion is None or telemetry.mode is not protocol.Mode.REGULATE:
            self._board_setpoint.restart()
            return
        welcome = self._firmware.welcome
        board_rate_kPa_per_s = welcome.rate_limit_kPa_per_s if welcome else math.inf
        rate_kPa_per_s = min(self.motion.rate_kPa_per_s, board_rate_kPa_per_s)
        self._board_setpoint.note(made_at, telemetry.setpoint_kPa, rate_kPa_per_s)

    @property
    def mode_mismatch_s(self) -> float:
        """The time for which the board has not followed the commanded mode."""
        return self._board_mode.mismatch_s(self._commanded_mode)

    @property
    def wrong_setpoint_kPa(self) -> tuple[float, float] | None:
        """A setpoint of the board that contradicts the commanded one, and the latter."""
        return self._board_setpoint.wrong if self.motion else None

    @property
    def _commanded_mode(self) -> protocol.Mode:
        return protocol.Mode.VENT if self.motion is None else protocol.Mode.REGULATE
