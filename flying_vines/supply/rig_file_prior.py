"""The prior of a diagnosed rig before it has flown, from its fitted numbers and causes.

`flying-vines diagnose --write-rig` writes such a file. This module uses the plant that the file describes:
leaks, shapes, walls, valves and sensors. A cause that changes none of the prior's numbers, such as a solenoid
that closes slowly, is not used. EVP: inflation valve. DVP: valve that supplies the Venturi. Pouch: the
bending pouch of the actuator.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.gas import ALPHA_KPA, GAMMA
from flying_vines.physics.plant.flow import FlowLaw, Ohm, flow_SL_per_s
from flying_vines.physics.plant.leak import Curve, LeakLaw, leak_of, leak_SL_per_s
from flying_vines.physics.plant.plant import Plant, Setup
from flying_vines.physics.plant.true_rig import TrueRig, true_rig_from
from flying_vines.physics.plant.valve_response import ValveMotion
from flying_vines.physics.plant.volume import Pouch, Wall, heat_capacity_J_per_K
from flying_vines.physics.rig import Rig, RigError, read_rig
from flying_vines.supply.rig_prior import AMBIENT_KPA, MIN_RISE_SHARE, Prior, RigPrior, nominal

# Relative standard deviations: a rig changes between its calibration and its flight.
CHANGED = 0.1
"""Air for a rise, and flow of a valve."""
LEAK_CHANGED = 0.2
POUCH_CHANGED = 0.5
"""Additional air for an inflation from flat: the pouch may be only partly flat."""
NO_LEAK_PER_S = 1e-4
"""A leak that a recording of one minute does not show."""
ZERO_SD_KPA = 3.0
"""Standard deviation of the reservoir sensor's zero and of the ambient pressure."""
MIN_KPA = 1.0
"""Lower bound of a pressure after the correction of the control volume's sensor."""
PARTLY_OPEN_SD = 0.2
VENTURI_STARTS_KPA = 3.0
"""The firmware starts the Venturi if the control volume is this far above its setpoint."""
VENTURI_ENDS_KPA = 1.0
"""The firmware stops the Venturi once the control volume is less than this above its setpoint."""
REGULATOR_S = 0.05
"""Reaction time of the regulator."""
OPENING_S = 0.12
"""Time in which the regulator opens the inflation valve fully."""
TOP_SHARE = 0.2
"""A cycle of `[pneumatics]` stays at the top for this share of its rise time."""
ISOTHERMAL = Wall(time_constant_s=1e-3)


@dataclass(frozen=True)
class RigFilePrior:
    """The prior from a rig file."""

    path: Path
    prior: RigPrior
    used: tuple[str, ...]
    """The causes that affect the prior."""
    unused: tuple[str, ...]
    """The causes that do not affect the prior."""

    @property
    def summary(self) -> str:
        """The basis of the cycles left, in one line."""
        p = self.prior.pneumatics
        text = f"reservoir {p.reservoir_volume_L:.3g} L, vine {p.cv_volume_L:.3g} L"
        for what, names in (("used for cycles left", self.used), ("unused", self.unused)):
            text += f"; {what}: {', '.join(names)}" if names else ""
        return text


def load_rig_file_prior(path: Path, p: PneumaticsConfig) -> RigFilePrior:
    """The prior from a rig file and the numbers of `[pneumatics]`.

    Raises `RigError` if the file cannot be read, has an unknown name, or has no control volume.
    """

    def prior(content: Mapping[str, Any]) -> RigFilePrior:
        try:
            return _rig_file_prior(path, p, true_rig_from(content))
        except ArithmeticError:
            raise RigError("its numbers together give no air for a bend: check their units.") from None

    return read_rig(path, prior)


def _rig_file_prior(path: Path, p: PneumaticsConfig, rig: TrueRig) -> RigFilePrior:
    prior = prior_of(p, rig)
    without = {
        name: replace(rig, causes={other: rig.causes[other] for other in rig.causes if other != name})
        for name in rig.causes
    }
    used = tuple(name for name, less in without.items() if prior_of(p, less, rig.complete) != prior)
    return RigFilePrior(path, prior, used, tuple(name for name in rig.causes if name not in used))


def prior_of(p: PneumaticsConfig, rig: TrueRig, complete: bool | None = None) -> RigPrior:
    """The prior of a rig with the cycle of `[pneumatics]`.

    If the rig is not `complete`, only its numbers are used, with the wide priors of `nominal` for all others.
    """
    setup = rig.setup
    numbers = _numbers(p, setup.plant.rig)
    if not (rig.complete if complete is None else complete):
        return nominal(numbers)
    return _known(numbers, setup)


def _numbers(p: PneumaticsConfig, rig: Rig) -> PneumaticsConfig:
    if rig.cv is None:
        raise RigError("the rig has no [cv], so there is nothing to inflate.")
    if rig.pump is not None:
        raise RigError("the rig has a pump, but a vine is inflated from a reservoir.")
    return msgspec.structs.replace(
        p,
        reservoir_volume_L=rig.reservoir.volume_L,
        cv_volume_L=rig.cv.volume_L,
        evp_flow_resistance_kPa_s_per_SL=rig.evp.flow_resistance_kPa_s_per_SL,
        dvp_flow_resistance_kPa_s_per_SL=rig.dvp.flow_resistance_kPa_s_per_SL,
    )


def _known(p: PneumaticsConfig, setup: Setup) -> RigPrior:
    plant, effects = setup.plant, setup.plant.effects
    motion = effects.evp_motion or ValveMotion()
    kPa_per_SL = ALPHA_KPA / p.reservoir_volume_L
    gain, offset_kPa = setup.cv_sensor.gain, setup.cv_sensor.offset_kPa
    top_kPa = max(MIN_KPA, p.cycle_swing_kPa / gain - offset_kPa)
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
    leak = _leak_SL_per_s_kPa(effects.reservoir_leaks, half_kPa) * kPa_per_SL
    cv_leak = _leak_SL_per_s_kPa(effects.cv_leaks, top_kPa) * kPa_per_SL / gain
    return RigPrior(
        pneumatics=p,
        rise=Prior(rise, CHANGED * rise),
        min_rise=MIN_RISE_SHARE * rise,
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
        + setup.cv_sensor.time_constant_s,
        cycle_rise_kPa=rise_kPa,
        cycle_venturi_s=venturi_s,
        reservoir_gain=setup.reservoir_sensor.gain,
        reservoir_offset_kPa=setup.reservoir_sensor.offset_kPa,
        zero_sd_kPa=ZERO_SD_KPA,
    )


def _air_SL_per_kPa(p: PneumaticsConfig, plant: Plant, top_kPa: float) -> float:
    """Air per kPa that fills the control volume and its tube; for a pouch, once it is not flat.

    A volume V at p_a becomes V (1 + k P) at P + p_a. It takes less air if the gas is still warm at the end of
    the inflation. For a rise of P in the time T, with e = p_a (θ − 1) and the gas temperature θ relative to
    ambient: γ de/dt = (γ − 1) P/T − e/τ.
    """
    volume_L = p.cv_volume_L * (1.0 + plant.shape.per_kPa * (AMBIENT_KPA + top_kPa))
    rise_s = p.cycle_swing_kPa / p.cycle_rate_kPa_per_s
    if (wall := plant.effects.cv_wall) is not None:
        gas_J_per_K = heat_capacity_J_per_K(AMBIENT_KPA + 0.5 * top_kPa, p.cv_volume_L)
        cools_per_s = wall.rates(gas_J_per_K).gas_per_s / GAMMA
        lost = (1.0 - math.exp(-cools_per_s * rise_s)) / (cools_per_s * rise_s) if cools_per_s else 1.0
        warm_share = (GAMMA - 1.0) / GAMMA * lost * math.exp(-cools_per_s * TOP_SHARE * rise_s)
        volume_L *= 1.0 - warm_share
    if plant.tubing is not None:
        volume_L += plant.tubing.volume_L
    return volume_L / ALPHA_KPA


def _motive_SL_per_s(p: PneumaticsConfig, plant: Plant, supply_kPa: float) -> float:
    """Flow through the Venturi's supply valve, in series with the nozzle if the rig has one."""
    law = plant.effects.dvp_law or Ohm(p.dvp_flow_resistance_kPa_s_per_SL)
    motive = _flow_SL_per_s(law, supply_kPa)
    ejector = plant.effects.ejector
    if ejector is not None and (nozzle := ejector.nozzle_conductance_SL_per_s_kPa) is not None:
        motive = 1.0 / math.hypot(1.0 / motive, 1.0 / (nozzle * (supply_kPa + AMBIENT_KPA)))
    return motive


def _venturi_s(p: PneumaticsConfig, plant: Plant, offset_kPa: float) -> float:
    """Time for which the Venturi runs in a cycle of `[pneumatics]`; 0 if the outlet alone is fast enough.

    The pressure falls at P/τ; with the Venturi at (P + P_vac)/τ. Below P = r τ the outlet alone does not
    follow a setpoint that falls at rate r. The vine is farthest behind when the setpoint reaches 0: its
    pressure is then r τ/e. The sensor's offset adds to this difference.
    """
    law = plant.effects.solenoid_law or Ohm(plant.rig.solenoid.flow_resistance_kPa_s_per_SL)
    leaves_per_s = _flow_SL_per_s(law, p.cycle_swing_kPa) / p.cycle_swing_kPa * ALPHA_KPA / p.cv_volume_L
    behind_kPa = min(p.cycle_rate_kPa_per_s / leaves_per_s / math.e, p.cycle_swing_kPa)
    if behind_kPa + offset_kPa < VENTURI_STARTS_KPA:
        return 0.0
    vacuum_kPa = plant.rig.venturi.full_vacuum_kPa
    stops_kPa = max(MIN_KPA, VENTURI_ENDS_KPA - offset_kPa + vacuum_kPa)
    return math.log(max(1.0, (behind_kPa + vacuum_kPa) / stops_kPa)) / leaves_per_s


def _leak_SL_per_s_kPa(laws: Iterable[LeakLaw | Curve | None], at_kPa: float) -> float:
    """Flow through leaks to ambient, per kPa of gauge pressure."""
    return leak_SL_per_s(leak_of(laws), AMBIENT_KPA + at_kPa, AMBIENT_KPA, 1.0, 1.0) / at_kPa


def _flow_SL_per_s(law: FlowLaw, supply_kPa: float) -> float:
    return flow_SL_per_s(law.numbers(), AMBIENT_KPA + supply_kPa, AMBIENT_KPA, 1.0, 1.0)
