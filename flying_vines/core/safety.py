"""Judges motions, and responds to losses, faults and limits: one pure state machine.

A loss ends by itself. A latched fault lasts until a person clears it. A limit vents the vine once, at the
moment it is crossed. During a loss or fault the vine is vented and cannot bend. Only a loss of RC may hold
the vine for some time instead, if the configuration says so. After a loss only a new trigger moves the vine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, NamedTuple

from firmware_link.protocol import Fault
from flying_vines.config.config import Config, InterlocksConfig
from flying_vines.supply import AirNeeded
from flying_vines.vine.intent import ACTS_WITHIN_S
from flying_vines.vine.motion import Motion

MODE_FOLLOWS_WITHIN_S = 0.3
"""The board's mode follows the commanded one within this time, even if eleven commands in a row are lost."""
ARMED_CONFIRMED_S = 1.5
"""A vehicle counts as armed after this time without a HEARTBEAT that says "disarmed". The autopilot sends one
each second, so a forged "armed" does not last so long."""
LANDING_MARGIN_M = 0.5
"""A bent vine is vented when it is this far below `interlocks.min_altitude_m`."""

INTERNAL_ERROR = "internal error: restart the service"

FAULT_SENTENCES = {
    Fault.DEAD_MAN: "dead-man timer ran out",
    Fault.CV_OVERPRESSURE: "over-pressure in the vine",
    Fault.RESERVOIR_OVERPRESSURE: "over-pressure in the reservoir",
    Fault.CV_SENSOR: "vine pressure sensor",
    Fault.RESERVOIR_SENSOR: "reservoir pressure sensor",
    Fault.WATCHDOG_RESET: "watchdog reset",
    Fault.SETTINGS: "stored settings damaged (set and store them: flying-vines link --set)",
    Fault.SUPPLY: "sensors' 5 V supply",
    Fault.VENTURI: "the Venturi blows into the vine",
}


BOARD_SETTINGS = "board_settings"
"""The board has other settings than in the last flight, so its pressures may be wrong. No routine request
clears this latched fault."""


class SafetyInputs(NamedTuple):
    """The inputs of safety at one moment. Pressures are gauge kPa, NaN when unknown."""

    pneumatics_armed: bool = True
    """A person allows the vine to bend."""
    armed: bool = False
    """The vehicle is armed."""
    armed_s: float = math.inf
    """Time since the vehicle was armed."""
    conflict: str = ""
    """A sentence about two senders that both claim to be the autopilot."""
    altitude_m: float | None = None
    rc_problem: str | None = None
    """Why RC cannot be trusted; None if it can, or if RC is not in use."""
    autopilot_age_s: float | None = None
    """Time since the autopilot's last frame; None before the first one."""
    heartbeat_missing: bool = False
    """The autopilot sends other messages, but no HEARTBEAT. So `armed` is unknown."""
    link_delay_s: float = 0.0
    """How late the autopilot's messages come."""
    firmware_ready: bool = False
    firmware_was_ready: bool = False
    firmware_problem: str = "not connected"
    telemetry_age_s: float = math.inf
    faults: Fault = Fault.NONE
    sensor_problem: str | None = None
    """A sentence about a telemetry value that no sensor can have."""
    cv_kPa: float = math.nan
    reservoir_kPa: float = math.nan
    mode_mismatch_s: float = 0.0
    """The board's mode has differed from the commanded one for this time."""
    wrong_setpoint_kPa: tuple[float, float] | None = None
    """The board's setpoint that contradicts the commanded one, and the latter."""
    restarting: str = ""
    """A sentence about a series of board restarts; empty after fewer than two restarts."""
    bench: bool = False
    """Bench mode is on: the vine may bend on the ground."""
    moving: bool = False
    """The vine is held or moved under pressure."""
    moving_s: float = 0.0
    """Time since the present motion was requested. A hold by safety is no request."""
    physics: Mapping[str, str] = MappingProxyType({})
    """A sentence for each physics check that found a fault."""
    internal_error: bool = False
    """A part of the service that the vine needs has failed."""


@dataclass(frozen=True, slots=True)
class Ruling:
    """The answer to a request. `rate_scale` is the allowed share of a motion's rate, 0…1."""

    verdict: Literal["accepted", "limited", "refused"]
    reason: str = ""
    rate_scale: float = 1.0
    has_effect: bool = True
    """False: accepted, but there was nothing to do."""


@dataclass(frozen=True, slots=True)
class ResponseNeeded:
    """A loss or fault began, or a limit was crossed: vent or hold the vine."""

    name: str
    reason: str
    response: Literal["vent", "hold"]


@dataclass(frozen=True, slots=True)
class LossEnded:
    """The loss `name` ended. The vine stays as it is until a new trigger."""

    name: str


def needed_kPa(top_kPa: float, spending_kPa: float, interlocks: InterlocksConfig) -> float:
    """The reservoir pressure below which a bend is refused: for its end, its air and the reserve."""
    return top_kPa + interlocks.reserve_kPa + spending_kPa


class Safety:
    """Call `watch` often, and `judge` for every motion.

    `latched` are the faults of the last run that nobody has cleared: they stay latched.
    """

    def __init__(self, config: Config, latched: Mapping[str, str] = MappingProxyType({})) -> None:
        self.configure(config)
        self._present: dict[str, str] = {}
        self._latched = dict(latched)
        self._latched_at: dict[str, float] = {}
        """When the cause of each fault last appeared; at the earliest when this run began."""
        self._causes: set[str] = set()
        self._faults = Fault.NONE
        self._faults_at = -math.inf
        """When the firmware last reported a new fault."""
        self._held_s = 0.0
        """Total time that the vine was held since the last trigger, over all losses."""
        self._held_at: float | None = None
        """When `_held_s` was last updated; None while the vine is not held."""
        self._crossed: set[str] = set()
        """The limits that are crossed now."""

    def configure(self, config: Config) -> None:
        """Use these limits from now on. Present losses and latched faults remain."""
        self._limits = config.limits
        self._interlocks = config.interlocks
        self._losses = config.losses
        self._actuator = config.firmware.name

    @property
    def reasons(self) -> dict[str, str]:
        """A sentence for each present loss and latched fault, by name."""
        return {**self._present, **self._latched}

    @property
    def latched(self) -> dict[str, str]:
        """The latched faults without the internal error, which a restart of the service clears."""
        return {name: reason for name, reason in self._latched.items() if name != "internal_error"}

    def triggered(self) -> None:
        """A request was carried out. The next loss may hold the vine for the full time again.

        A loss that holds the vine now gets no extra time.
        """
        if self._held_at is None:
            self._held_s = 0.0

    def watch(self, t: float, now: SafetyInputs) -> list[ResponseNeeded | LossEnded]:
        """The losses, faults and limits that began, and the losses that ended, at time `t`."""
        changes: list[ResponseNeeded | LossEnded] = []
        for name in self._latched.keys() - self._latched_at.keys():
            self._latched_at[name] = t
        causes = self._latching(now)
        for name, cause in causes.items():
            if name not in self._latched:
                changes.append(self.latch(t, name, cause))
            elif name not in self._causes:
                self._latched_at[name] = t
        self._causes = set(causes)
        if has_new_fault := bool(int(now.faults) & ~int(self._faults)):
            self._faults_at = t
        self._faults = now.faults
        if self._held_at is not None:
            self._held_s += t - self._held_at
            self._held_at = t
        for name, check in _LOSSES.items():
            reason = check(self, now)
            if reason and (name not in self._present or (name == "firmware_fault" and has_new_fault)):
                response = self._response(name)
                if response == "hold":
                    self._held_at = t
                changes.append(ResponseNeeded(name, reason, response))
            elif not reason and name in self._present:
                del self._present[name]
                if name == "rc":
                    self._held_at = None
                changes.append(LossEnded(name))
            if reason:
                self._present[name] = reason
        if self._held_at is not None and self._held_s >= self._losses.hold_at_most_s:
            self._held_at = None
            changes.append(ResponseNeeded("rc", f"{self._present['rc']}, hold time is over", "vent"))
        for name, check in _LIMITS.items():
            reason = check(self, now) if now.moving else None
            if not reason:
                self._crossed.discard(name)
            elif name not in self._crossed:
                self._crossed.add(name)
                changes.append(ResponseNeeded(name, reason, "vent"))
        return changes

    def _response(self, name: str) -> Literal["vent", "hold"]:
        """Only a loss of RC may hold the vine. After other losses altitude or pressure is unknown: vent."""
        if name == "rc" and self._held_s < self._losses.hold_at_most_s:
            return self._losses.on_rc_loss
        return "vent"

    def _latching(self, now: SafetyInputs) -> dict[str, str]:
        """A sentence for each cause of a latched fault that is present now."""
        causes = {
            "internal_error": INTERNAL_ERROR if now.internal_error else None,
            "sensor": now.sensor_problem,
            "overpressure": self._overpressure(now),
            "regulates": self._regulates(now),
            "setpoint": self._setpoint(now),
            "firmware_reset": now.restarting,
        }
        return {**{name: cause for name, cause in causes.items() if cause}, **now.physics}

    def latch(self, t: float, name: str, reason: str) -> ResponseNeeded:
        self._latched[name] = reason
        self._latched_at[name] = t
        return ResponseNeeded(name, reason, "vent")

    def clear(
        self, now: SafetyInputs, seen_at: float = math.inf, *, on_request: bool = False
    ) -> dict[str, str]:
        """A person clears latched faults. Returns a sentence for each cleared fault, by name.

        A fault stays if its cause is present, or came after `seen_at`: then the person has not seen it.
        `on_request`: the person has asked for that, not for a vent or a straight vine.
        """
        stays = {*self._latching(now), *(() if on_request else (BOARD_SETTINGS,))}
        cleared = [name for name in self._latched if name not in stays and self._latched_at[name] <= seen_at]
        for name in cleared:
            del self._latched_at[name]
        return {name: self._latched.pop(name) for name in cleared}

    def firmware_faults_seen(self, seen_at: float) -> bool:
        """True if all faults that the firmware reports now were present at `seen_at`."""
        return self._faults_at <= seen_at

    def judge(self, motion: Motion, air: AirNeeded, now: SafetyInputs) -> Ruling:
        """Accept, limit or refuse a motion. A motion that only deflates is always accepted."""
        if motion.only_deflates:
            return Ruling("accepted")
        problem = self._problem(motion, air, now)
        if problem:
            return Ruling("refused", problem)
        if motion.wanted_kPa > motion.top_kPa + 1e-6:
            return Ruling("limited", f"to {motion.top_kPa:g} kPa")
        left_kPa = now.reservoir_kPa - motion.top_kPa
        if left_kPa < air.floor_kPa:
            return Ruling(
                "limited", f"slower: reservoir at {now.reservoir_kPa:.0f} kPa", left_kPa / air.floor_kPa
            )
        return Ruling("accepted")

    def _problem(self, motion: Motion, air: AirNeeded, now: SafetyInputs) -> str | None:
        if self.reasons:
            return "; ".join(self.reasons.values())
        if not now.pneumatics_armed:
            return "the pneumatics are disarmed"
        if not now.firmware_ready:
            return f"{self._actuator} {now.firmware_problem}"
        if not now.telemetry_age_s <= self._losses.telemetry_s:
            return f"no telemetry from {self._actuator}"
        if not self._on_bench(now):
            if now.autopilot_age_s is None:
                return "no autopilot"
            if not now.armed:
                return "not armed"
            if now.armed_s < ARMED_CONFIRMED_S:
                return f"armed less than {ARMED_CONFIRMED_S:g} s ago"
            if now.altitude_m is None:
                return "altitude not known"
            if now.altitude_m < self._interlocks.min_altitude_m:
                return f"at {now.altitude_m:.1f} m, below {self._interlocks.min_altitude_m:g} m"
        least_kPa = needed_kPa(motion.top_kPa, air.spending_kPa, self._interlocks)
        if not now.reservoir_kPa >= least_kPa:
            return f"reservoir at {now.reservoir_kPa:.0f} kPa, needs {least_kPa:.0f}"
        return None

    def _on_bench(self, now: SafetyInputs) -> bool:
        return now.bench or self._interlocks.bench_mode

    # Each check returns a sentence about its loss, fault or limit, or None.

    def _overpressure(self, now: SafetyInputs) -> str | None:
        if now.cv_kPa > self._limits.overpressure_kPa:
            return f"vine at {now.cv_kPa:.1f} kPa, limit {self._limits.overpressure_kPa:g}"
        return None

    def _regulates(self, now: SafetyInputs) -> str | None:
        """The board regulates after a vent command. The host repeats the command and sends no setpoint."""
        mismatch = not now.moving and now.mode_mismatch_s > MODE_FOLLOWS_WITHIN_S
        return f"{self._actuator} does not vent" if mismatch else None

    def _setpoint(self, now: SafetyInputs) -> str | None:
        """The board regulates to a pressure that nobody commanded."""
        if now.wrong_setpoint_kPa is None:
            return None
        board_kPa, commanded_kPa = now.wrong_setpoint_kPa
        return f"{self._actuator} setpoint is {board_kPa:.1f} kPa, commanded {commanded_kPa:.1f}"

    def _rc(self, now: SafetyInputs) -> str | None:
        return f"RC lost: {now.rc_problem}" if now.rc_problem else None

    def _autopilot(self, now: SafetyInputs) -> str | None:
        if now.autopilot_age_s is not None and now.autopilot_age_s > self._losses.autopilot_s:
            return f"autopilot silent for {self._losses.autopilot_s:g} s"
        return "no HEARTBEAT: arm state unknown" if now.heartbeat_missing else None

    def _late(self, now: SafetyInputs) -> str | None:
        """Late messages hide a loss of RC, a landing and the pilot's moves for as long as they are late."""
        late = now.link_delay_s > ACTS_WITHIN_S
        return f"vehicle link more than {ACTS_WITHIN_S:g} s late" if late else None

    def _conflict(self, now: SafetyInputs) -> str | None:
        return now.conflict or None

    def _serial(self, now: SafetyInputs) -> str | None:
        if now.firmware_was_ready and not now.firmware_ready:
            return f"{self._actuator} {now.firmware_problem}"
        return None

    def _telemetry(self, now: SafetyInputs) -> str | None:
        if now.firmware_ready and not now.telemetry_age_s <= self._losses.telemetry_s:
            return f"{self._actuator} telemetry stale"
        return None

    def _firmware_fault(self, now: SafetyInputs) -> str | None:
        if not now.faults:
            return None
        names = [sentence for fault, sentence in FAULT_SENTENCES.items() if fault in now.faults]
        return f"firmware fault: {', '.join(names) or f'0x{int(now.faults):04x}'}"

    def _reservoir(self, now: SafetyInputs) -> str | None:
        if now.reservoir_kPa < self._interlocks.reserve_kPa:
            return f"reservoir low: {now.reservoir_kPa:.0f} kPa"
        return None

    def _deaf(self, now: SafetyInputs) -> str | None:
        """The board stays in VENT after a setpoint, because the wire to the board is broken.

        A board in VENT runs no dead-man timer and still sends telemetry. Only its mode shows the break.
        """
        mismatch = now.mode_mismatch_s > MODE_FOLLOWS_WITHIN_S
        return f"{self._actuator} gets no commands" if mismatch else None

    def _disarmed(self, now: SafetyInputs) -> str | None:
        return "disarmed" if not now.armed and not self._on_bench(now) else None

    def _altitude(self, now: SafetyInputs) -> str | None:
        lowest_m = self._interlocks.min_altitude_m - LANDING_MARGIN_M
        if self._on_bench(now) or lowest_m <= 0:
            return None
        if now.altitude_m is None:
            return "altitude no longer known"
        return f"landing, at {now.altitude_m:.1f} m" if now.altitude_m < lowest_m else None

    def _duration(self, now: SafetyInputs) -> str | None:
        if now.moving_s > self._limits.max_bent_s:
            return f"bent for {self._limits.max_bent_s:g} s"
        return None


_Check = Callable[[Safety, SafetyInputs], str | None]
_LOSSES: dict[str, _Check] = {
    "rc": Safety._rc,
    "autopilot": Safety._autopilot,
    "late": Safety._late,
    "conflict": Safety._conflict,
    "serial": Safety._serial,
    "telemetry": Safety._telemetry,
    "firmware_fault": Safety._firmware_fault,
}
_LIMITS: dict[str, _Check] = {
    "reservoir": Safety._reservoir,
    "deaf": Safety._deaf,
    "disarmed": Safety._disarmed,
    "altitude": Safety._altitude,
    "duration": Safety._duration,
}
