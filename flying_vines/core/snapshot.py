"""The state of the core at one moment, for displays and logs."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from flying_vines.core.pending_bend import PendingBend
from flying_vines.supply import CyclesLeft


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything that a display or a log shows of one moment. Gauge kPa, degrees; NaN is unknown."""

    t: float
    vehicle: str
    mode: str
    armed: bool
    altitude_m: float
    rc: str
    switch_position: int | None
    actuator: str
    """The actuator's name: phloSAR, or the `kind` of an actuator from an installed package."""
    firmware: str
    """What is known of the actuator: "ready", "silent for 9 s", "does not answer"."""
    round_trip_s: float | None
    """Round trip of the latest ping to the firmware."""
    telemetry_gaps: int
    reservoir_kPa: float
    cv_kPa: float
    command_kPa: float
    bend_deg: float
    evp_opening: float
    """Opening of the inflation valve, 0…1."""
    dvp_opening: float
    """Opening of the Venturi's supply valve, 0…1."""
    solenoid: bool | None
    cycles: CyclesLeft | None
    doing: str
    """What the vine does: the motion's name, "vented", "venting", or a vent that nothing confirms."""
    safe_state: dict[str, str] = field(default_factory=dict)
    unstable: dict[str, str] = field(default_factory=dict)
    """A sentence for each link that comes and goes, and for a computer that is too busy."""
    findings: dict[str, int] = field(default_factory=dict)
    """The number of findings of each physics check."""
    ambient_kPa: float = math.nan
    """Absolute, from the autopilot's barometer."""
    pneumatics_armed: bool = True
    bench: bool = False
    """Bench mode is on: the vine may bend on the ground."""
    waiting: PendingBend | None = None
    """The bend that is requested but not carried out, until a fresh request."""
