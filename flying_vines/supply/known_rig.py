"""What a diagnosed rig says of its air before it has flown: numbers as fitted, and what causes do to them.

`flying-vines diagnose --write-rig` writes such a file. What counts is the plant that it describes, whatever
the names of the causes: its leaks, shapes, walls, valves and the reservoir's sensor. What moves no air, as a
delay, changes nothing here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.constants import ALPHA_KPA, GAMMA
from flying_vines.physics.plant.flow import FlowLaw, Ohm, flow_SL_per_s
from flying_vines.physics.plant.motion import ValveMotion
from flying_vines.physics.plant.plant import Plant
from flying_vines.physics.plant.setup import Setup
from flying_vines.physics.plant.shape import Pouch
from flying_vines.physics.plant.true_rig import TrueRig, true_rig_from
from flying_vines.physics.plant.wall import Wall, heat_capacity_J_per_K
from flying_vines.physics.rig import Rig, RigError, read_rig
from flying_vines.supply.belief import AMBIENT_KPA, LEAST_RISE, Belief, Prior, nominal

CHANGED = 0.1
"""One standard deviation, of what a rig is from its calibration to its flight: of what a rise takes …"""
LEAK_CHANGED = 0.2
"""… of a leak …"""
POUCH_CHANGED = 0.5
"""… and of how flat a pouch is when it is filled."""
NO_LEAK_PER_S = 1e-4
"""What passes for none in a minute's recording."""
ZERO_SD_KPA = 3.0
"""Of the reservoir's sensor, and of the ambient pressure."""
LEAST_KPA = 1.0
"""To which a cycle goes, whatever the sensor of the control volume makes of it."""
PARTLY_OPEN_SD = 0.2
VENTURI_STARTS_KPA = 3.0
VENTURI_ENDS_KPA = 1.0
"""How far the control volume is behind when the firmware calls the Venturi, and when it stops it."""
REGULATOR_S = 0.05
OPENING_S = 0.12
"""What the regulator takes to act, and to go through the whole opening of the inflation valve."""
TOP_SHARE = 0.2
"""For how much of its rise's time the cycle of `[pneumatics]` stays at the top."""
ISOTHERMAL = Wall(time_constant_s=1e-3)


@dataclass(frozen=True)
class KnownRig:
    """What a rig file gives."""

    path: Path
    belief: Belief
    used: tuple[str, ...]
    """The causes that it rests on."""
    unused: tuple[str, ...]
    """Those that say nothing of the bottle's air."""

    @property
    def said(self) -> str:
        """What the cycles left rest on, in a line."""
        p = self.belief.pneumatics
        said = f"bottle {p.reservoir_volume_L:.3g} L, vine {p.cv_volume_L:.3g} L"
        for what, names in (("in the cycles left", self.used), ("of no use there", self.unused)):
            said += f"; {what}: {', '.join(names)}" if names else ""
        return said


def load_calibration(path: Path, p: PneumaticsConfig) -> KnownRig:
    """What a rig file makes of the numbers of `[pneumatics]`.

    RigError when the file cannot be read, names something unknown, or has nothing to inflate.
    """
    return read_rig(path, lambda content: _calibration(path, p, true_rig_from(content)))


def _calibration(path: Path, p: PneumaticsConfig, rig: TrueRig) -> KnownRig:
    belief = believed(p, rig)
    without = {
        name: replace(rig, causes={other: rig.causes[other] for other in rig.causes if other != name})
        for name in rig.causes
    }
    used = tuple(name for name, less in without.items() if believed(p, less, rig.complete) != belief)
    return KnownRig(path, belief, used, tuple(name for name in rig.causes if name not in used))


def believed(p: PneumaticsConfig, rig: TrueRig, complete: bool | None = None) -> Belief:
    """What a rig makes of the numbers of `[pneumatics]`, for one that flies it.

    A rig of which only the numbers are told is as any rig in all else, unless it is said to be `complete`.
    """
    there = rig.setup
    numbers = _numbers(p, there.plant.rig)
    if not (rig.complete if complete is None else complete):
        return nominal(numbers)
    return _known(numbers, there)


def _numbers(p: PneumaticsConfig, rig: Rig) -> PneumaticsConfig:
    if rig.cv is None:
        raise RigError("the rig has no [cv], so that there is nothing to inflate.")
    return msgspec.structs.replace(
        p,
        reservoir_volume_L=rig.reservoir.volume_L,
        cv_volume_L=rig.cv.volume_L,
        evp_flow_resistance_kPa_s_per_SL=rig.evp.flow_resistance_kPa_s_per_SL,
        dvp_flow_resistance_kPa_s_per_SL=rig.dvp.flow_resistance_kPa_s_per_SL,
    )


def _known(p: PneumaticsConfig, there: Setup) -> Belief:
    plant, effects = there.plant, there.plant.effects
    motion = effects.evp_motion or ValveMotion()
    kPa_per_SL = ALPHA_KPA / p.reservoir_volume_L
    gain, offset_kPa = there.cv_sensor.gain, there.cv_sensor.offset_kPa
    top_kPa = max(LEAST_KPA, p.cycle_swing_kPa / gain - offset_kPa)
    rise = _air_SL_per_kPa(p, plant, top_kPa) * kPa_per_SL / gain
    pouch_kPa = 0.0
    if isinstance(plant.shape, Pouch):
        pouch_kPa = (p.cv_volume_L - plant.shape.flat_volume_L) * AMBIENT_KPA / p.reservoir_volume_L
    half_kPa = 0.5 * p.full_kPa
    venturi_s = _venturi_s(p, plant, offset_kPa)
    rise_kPa = gain * top_kPa
    if venturi_s > 0.0:
        rise_kPa = max(rise_kPa, p.cycle_swing_kPa - VENTURI_ENDS_KPA)
    evp = effects.evp_law or Ohm(p.evp_flow_resistance_kPa_s_per_SL)
    motive = _motive_SL_per_s(p, plant, half_kPa) * kPa_per_SL / (half_kPa + AMBIENT_KPA)
    leak = _leak_SL_per_s_kPa(effects.reservoir_leak, half_kPa) * kPa_per_SL
    cv_leak = _leak_SL_per_s_kPa(effects.cv_leak, top_kPa) * kPa_per_SL / gain
    return Belief(
        pneumatics=p,
        rise=Prior(rise, CHANGED * rise),
        least_rise=LEAST_RISE * rise,
        flat=Prior(pouch_kPa, POUCH_CHANGED * pouch_kPa + CHANGED * rise),
        packed_kPa=pouch_kPa,
        venturi=Prior(motive, CHANGED * motive),
        leak=Prior(leak, LEAK_CHANGED * leak + NO_LEAK_PER_S),
        cv_leak=Prior(cv_leak, LEAK_CHANGED * cv_leak + NO_LEAK_PER_S),
        wall=effects.reservoir_wall or ISOTHERMAL,
        warmth_sd=0.2,
        evp_law=evp,
        rating_sd=CHANGED,
        dead_opening=motion.dead_opening,
        partly_open_sd=PARTLY_OPEN_SD,
        response_s=REGULATOR_S
        + OPENING_S * (motion.dead_opening + 0.5 * motion.backlash_width)
        + motion.delay_s
        + motion.time_constant_s
        + there.cv_sensor.time_constant_s,
        cycle_rise_kPa=rise_kPa,
        cycle_venturi_s=venturi_s,
        reservoir_gain=there.reservoir_sensor.gain,
        reservoir_offset_kPa=there.reservoir_sensor.offset_kPa,
        zero_sd_kPa=ZERO_SD_KPA,
    )


def _air_SL_per_kPa(p: PneumaticsConfig, plant: Plant, top_kPa: float) -> float:
    """What fills the control volume and its tube to a pressure, for each kPa; once it is full, of a pouch.

    V (1 + k P) at P + p_a for V at p_a; less, where the gas is still warm when the inflation ends, for warm
    gas fills more: with p_a (θ − 1) = e and a rise of P over T, γ de/dt = (γ − 1) P/T − e/τ.
    """
    volume_L = p.cv_volume_L * (1.0 + plant.shape.per_kPa * (AMBIENT_KPA + top_kPa))
    rise_s = p.cycle_swing_kPa / p.cycle_rate_kPa_per_s
    if (wall := plant.effects.cv_wall) is not None:
        gas_J_per_K = heat_capacity_J_per_K(AMBIENT_KPA + 0.5 * top_kPa, p.cv_volume_L)
        cools_per_s = wall.rates(gas_J_per_K).gas_per_s / GAMMA
        lost = (1.0 - math.exp(-cools_per_s * rise_s)) / (cools_per_s * rise_s) if cools_per_s else 1.0
        warm_share = (GAMMA - 1.0) / GAMMA * lost * math.exp(-cools_per_s * TOP_SHARE * rise_s)
        volume_L *= 1.0 - warm_share
    if plant.effects.tubing is not None:
        volume_L += plant.effects.tubing.volume_L
    return volume_L / ALPHA_KPA


def _motive_SL_per_s(p: PneumaticsConfig, plant: Plant, supply_kPa: float) -> float:
    """Through the Venturi and its supply valve, in series where the rig says so."""
    law = plant.effects.dvp_law or Ohm(p.dvp_flow_resistance_kPa_s_per_SL)
    motive = _flow_SL_per_s(law, supply_kPa)
    ejector = plant.effects.ejector
    if ejector is not None and (nozzle := ejector.nozzle_conductance_SL_per_s_kPa) is not None:
        motive = 1.0 / math.hypot(1.0 / motive, 1.0 / (nozzle * (supply_kPa + AMBIENT_KPA)))
    return motive


def _venturi_s(p: PneumaticsConfig, plant: Plant, offset_kPa: float) -> float:
    """How long the Venturi helps in a cycle of `[pneumatics]`, where what leaves by itself is too slow.

    Air leaves at P/τ; with the Venturi at (P + P_vac)/τ. On the way down at a rate r that is too slow from
    P = r τ on, and farthest behind when the setpoint is down: by r τ/e, at that pressure, and by what the
    sensor reads too much.
    """
    law = plant.effects.solenoid_law or Ohm(plant.rig.solenoid.flow_resistance_kPa_s_per_SL)
    leaves_per_s = _leak_SL_per_s_kPa(law, p.cycle_swing_kPa) * ALPHA_KPA / p.cv_volume_L
    behind_kPa = min(p.cycle_rate_kPa_per_s / leaves_per_s / math.e, p.cycle_swing_kPa)
    if behind_kPa + offset_kPa < VENTURI_STARTS_KPA:
        return 0.0
    vacuum_kPa = plant.rig.venturi.full_vacuum_kPa
    stops_kPa = max(LEAST_KPA, VENTURI_ENDS_KPA - offset_kPa + vacuum_kPa)
    return math.log(max(1.0, (behind_kPa + vacuum_kPa) / stops_kPa)) / leaves_per_s


def _leak_SL_per_s_kPa(law: FlowLaw | None, at_kPa: float) -> float:
    """Of an opening to ambient, per kPa of gauge pressure."""
    return _flow_SL_per_s(law, at_kPa) / at_kPa if law else 0.0


def _flow_SL_per_s(law: FlowLaw, supply_kPa: float) -> float:
    return flow_SL_per_s(law.numbers(), AMBIENT_KPA + supply_kPa, AMBIENT_KPA, 1.0, 1.0)
