"""One mishap on a random rig: the check or limit that finds it first, when, and the vine's pressure
meanwhile."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass, fields

from cycles_left_rigs import HOST_TICK_S, Case
from physics_checks_rigs import RESERVE_KPA, drawn

from firmware_link import protocol
from firmware_link.protocol import PROTOCOL_VERSION, Hello, Setpoint, Telemetry, Vent
from flying_vines.config.config import ChecksConfig, LimitsConfig
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.simulation.phlosar.mishaps import (
    Drifting,
    Filled,
    Gain,
    Glitching,
    Heated,
    Hole,
    HoseOff,
    Kinked,
    MishapKind,
    Noisy,
    Open,
    Shorted,
    Stuck,
    StuckAt,
)
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.supply import Features, TelemetryReader, nominal
from flying_vines.supply.physics_checks import PhysicsChecks

LIMITS = LimitsConfig()
RESTS_S = 8.0
"""Time in the vented state before the first manoeuvre."""
WATCHED_S = 25.0
"""Time after a mishap in which it can be found."""
WATCHED_LONGER_S = {"bottle sensor stuck": 100.0}

MISHAPS: Mapping[str, tuple[str, MishapKind]] = {
    "vine sensor stuck": ("cv_sensor", Stuck()),
    "vine sensor drifts up 1 kPa/s": ("cv_sensor", Drifting(1.0)),
    "vine sensor drifts down 1 kPa/s": ("cv_sensor", Drifting(-1.0)),
    "vine sensor dead": ("cv_sensor", Gain(0.0)),
    "vine sensor reads half": ("cv_sensor", Gain(0.5)),
    "vine sensor open": ("cv_sensor", Open()),
    "vine sensor shorted": ("cv_sensor", Shorted()),
    "vine sensor noisy, 5 kPa": ("cv_sensor", Noisy(5.0)),
    "vine sensor glitches": ("cv_sensor", Glitching(60.0, 97.0)),
    "bottle sensor stuck": ("reservoir_sensor", Stuck()),
    "bottle sensor drifts down 20 kPa/s": ("reservoir_sensor", Drifting(-20.0)),
    "bottle sensor open": ("reservoir_sensor", Open()),
    "bottle sensor shorted": ("reservoir_sensor", Shorted()),
    "bottle sensor noisy, 20 kPa": ("reservoir_sensor", Noisy(20.0)),
    "EVP stuck open": ("evp", StuckAt(1.0)),
    "EVP stuck half open": ("evp", StuckAt(0.5)),
    "EVP stuck at 0.1": ("evp", StuckAt(0.1)),
    "EVP stuck closed": ("evp", StuckAt(0.0)),
    "DVP stuck open": ("dvp", StuckAt(1.0)),
    "DVP stuck closed": ("dvp", StuckAt(0.0)),
    "solenoid stuck open": ("solenoid", StuckAt(1.0)),
    "solenoid stuck closed": ("solenoid", StuckAt(0.0)),
    "hose off": ("hose", HoseOff()),
    "hose kinked shut": ("hose", Kinked()),
    "hose kinked, 500 kPa·s/SL": ("hose", Kinked(500.0)),
    "actuator burst, 4 mm": ("actuator", Hole(4.0)),
    "actuator leaks, 0.5 mm": ("actuator", Hole(0.5)),
    "actuator leaks, 0.2 mm": ("actuator", Hole(0.2)),
    "bottle burst, 4 mm": ("bottle", Hole(4.0)),
    "bottle leaks, 0.5 mm": ("bottle", Hole(0.5)),
    "bottle empty": ("bottle", Filled(0.0)),
    "bottle overfilled, 780 kPa": ("bottle", Filled(780.0)),
    "bottle heated by 40 K": ("bottle", Heated(40.0)),
}


@dataclass(frozen=True)
class Noticed:
    """The check or limit that found a mishap first; `by` is empty if none did."""

    by: str
    after_s: float
    peak_kPa: float
    """Maximum of the vine's true pressure, from the mishap until 1 s after it was found."""


def true_rig(case: Case) -> TrueRig:
    """The true rig, with converters of 12 bits."""
    plant = case.plant
    missing = tuple(f.name for f in fields(plant.effects) if getattr(plant.effects, f.name) is None)
    return TrueRig(nominal=plant.rig, effects=plant.effects, likely=True, without=missing)


def fly(name: str, seed: int) -> Noticed:
    """Fly one rig, with this mishap at a random moment."""
    case = drawn(seed)
    dice = random.Random(f"{name} {seed}")
    begins_s = RESTS_S + dice.uniform(0.0, 8.0)
    fill_kPa = max(200.0, case.fill_kPa)
    phlosar = SimulatedPhlosar(true_rig(case), reservoir_kPa=fill_kPa, seed=seed)
    reader = TelemetryReader(nominal(case.believed))
    checks = PhysicsChecks(nominal(case.believed), ChecksConfig())
    codec = protocol.Codec()
    phlosar.receive(codec.encode(Hello(PROTOCOL_VERSION, 1)))
    manoeuvres = case.program
    watched_s = WATCHED_LONGER_S.get(name, WATCHED_S)
    which, begun_s = -1, 0.0
    peak_kPa, by, noticed_s = 0.0, "", 0.0
    tick = 0
    began = False
    while phlosar.now_s < (noticed_s + 1.0 if by else begins_s + watched_s):
        tick += 1
        now_s = tick * HOST_TICK_S
        if not began and now_s >= begins_s:
            began = True
            phlosar.inject(*MISHAPS[name])
        for message in codec.decode(phlosar.advance(now_s)):
            if isinstance(message, Telemetry):
                first = by or _first(reader.read(now_s, message), checks, began)
                if first and not by:
                    by, noticed_s = first, now_s
        if began:
            peak_kPa = max(peak_kPa, phlosar.cv_kPa)
        if by and not began:
            return Noticed(f"EARLY {by}", 0.0, peak_kPa)
        if by or now_s < RESTS_S:
            phlosar.receive(codec.encode(Vent(tick & 0xFFFF)))
            continue
        if which < 0 or now_s >= begun_s + manoeuvres[which % len(manoeuvres)].length_s:
            which, begun_s = which + 1, now_s
        manoeuvre = manoeuvres[which % len(manoeuvres)]
        target_kPa = min(LIMITS.max_kPa, manoeuvre.setpoint_kPa(now_s + HOST_TICK_S - begun_s))
        rate = manoeuvre.steepest_kPa_per_s
        phlosar.receive(codec.encode(Setpoint(target_kPa, rate, 250, tick & 0xFFFF)))
    return Noticed(by, max(0.0, noticed_s - begins_s), peak_kPa)


def _first(features: Features, checks: PhysicsChecks, began: bool) -> str:
    """The name of the check or limit that finds something wrong now; else empty."""
    found, telemetry = checks.take(features), features.telemetry
    if telemetry.faults:
        return f"firmware: {telemetry.faults.name}"
    if found:
        return found[0].name
    if features.cv_lower_kPa > LIMITS.overpressure_kPa:
        return "service: over-pressure"
    return "service: bottle low" if began and telemetry.reservoir_kPa < RESERVE_KPA else ""
