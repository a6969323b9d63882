"""Evaluates choices of parts for a robot: speed, cycles, mass and power, mostly by the paper's equations.

The search evaluates all choices of a catalogue, and finds the Pareto front of mass and performance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from flying_vines.physics import paper
from flying_vines.physics.arrays import Array
from flying_vines.studies.design.parts import (
    Catalogue,
    Origin,
    Part,
    PartsChoice,
    ReservoirPart,
    SolenoidPart,
    ValvePart,
    VenturiPart,
)
from flying_vines.studies.design.robot import Robot

Performance = Literal["cycles", "inflation", "deflation"]

DEFLATED = 0.05
"""Remaining share of the swing at which a deflation counts as finished: passive venting is exponential."""
POINTS = 60
MAX_RESERVOIRS = 2
"""Maximum number of equal reservoirs in parallel that the search tries."""


@dataclass(frozen=True)
class Evaluation:
    """A phloSAR of these parts, evaluated for a robot. Speeds are means over a full swing, kPa/s.

    The arrays have a value for each `reservoir_kPa`, from empty to `fill_kPa` (gauge). EVP: inflation valve.
    DVP: the Venturi's supply valve. Pouch: the bending pouch of an actuator.
    """

    robot: Robot
    parts: PartsChoice
    fill_kPa: float
    """The robot's fill pressure, limited by the weakest part."""

    reservoir_kPa: Array
    inflation_curve_kPa_per_s: Array
    """Eq. 4; for a pouch, scaled to the air that it needs."""
    deflation_curve_kPa_per_s: Array
    """The Venturi is used where it makes deflation faster."""
    passive_kPa_per_s: float
    """Deflation by the solenoid alone, at any reservoir pressure."""
    bandwidth_curve_Hz: Array
    """Eq. 7 with the inflation curve."""

    least_kPa: float
    """Minimum reservoir pressure for the wanted inflation speed (Sec. VI-B)."""
    cycles_rigid: float
    """Eq. 8: a rigid control volume, and a Venturi that uses as much air as the inflation. 0 if too slow."""
    cycles_pouch_air: float
    """Eq. 8 with the air of a pouch, but the minimum pressure of a rigid control volume."""
    cycles_pouch: float
    """Eq. 8 with the air of a pouch, also for the minimum pressure."""
    cycles_passive: float
    """Cycles of this robot if it is always vented passively: the Venturi uses no air."""

    full_open_s: float
    """Eq. 3 down to `least_kPa`: the paper's conservative estimate, with the EVP always open."""
    mass_kg: float
    mass_by_origin_kg: dict[Origin, float]
    power_W: float
    """Mean over a cycle: half inflation, half deflation, with the valves fully on."""

    @property
    def inflation_kPa_per_s(self) -> float:
        """Inflation speed from a full reservoir."""
        return float(self.inflation_curve_kPa_per_s[-1])

    @property
    def deflation_kPa_per_s(self) -> float:
        """Deflation speed with a full reservoir."""
        return float(self.deflation_curve_kPa_per_s[-1])

    @property
    def bandwidth_Hz(self) -> float:
        """Bandwidth with a full reservoir."""
        return float(self.bandwidth_curve_Hz[-1])

    @property
    def passive_is_enough(self) -> bool:
        """True if the wanted deflation needs no Venturi."""
        return self.passive_kPa_per_s >= self.robot.wanted_deflation_kPa_per_s

    @property
    def least_for_deflation_kPa(self) -> float | None:
        """Minimum reservoir pressure for the wanted deflation; None if no pressure is enough.

        0 if passive venting is enough. Rounded up to a point of the curve.
        """
        enough = self.deflation_curve_kPa_per_s >= self.robot.wanted_deflation_kPa_per_s
        return float(self.reservoir_kPa[int(np.argmax(enough))]) if enough.any() else None

    @property
    def cycles(self) -> float:
        """Cycles of this robot on these parts, including the Venturi's air if there is a Venturi."""
        if self.parts.venturi is None:
            return self.cycles_passive
        return self.cycles_pouch if self.robot.cv_kind == "pouch" else self.cycles_rigid

    @property
    def operating_s(self) -> float:
        """Duration of these cycles without pauses."""
        return self.cycles / self.robot.cycle_rate_Hz

    @property
    def total_kg(self) -> float:
        """Total mass, with the robot's other mass."""
        return self.mass_kg + self.robot.other_mass_kg

    @property
    def missed(self) -> dict[str, str]:
        """The requirements that these parts do not meet, each with the numbers; empty if they meet all."""
        robot = self.robot
        found = {}
        for name, has, wanted in (
            ("inflation", self.inflation_kPa_per_s, robot.wanted_inflation_kPa_per_s),
            ("deflation", self.deflation_kPa_per_s, robot.wanted_deflation_kPa_per_s),
        ):
            if has < wanted:
                found[name] = f"{name} {has:.3g} of {wanted:.3g} kPa/s"
        if self.fill_kPa <= robot.pressure_kPa:
            found["fill"] = f"a fill of {self.fill_kPa:.3g} kPa is not above {robot.pressure_kPa:.3g} kPa"
        if self.cycles < robot.least_cycles:
            found["cycles"] = f"{math.floor(self.cycles)} of {robot.least_cycles:.4g} cycles"
        if self.total_kg > robot.payload_kg:
            found["payload"] = f"{self.total_kg:.2f} kg of {robot.payload_kg:.2f} kg payload"
        return found

    @property
    def shortfalls(self) -> tuple[str, ...]:
        """The texts of `missed`."""
        return tuple(self.missed.values())

    def performance(self, by: Performance) -> float:
        """Cycles, or kPa/s from a full reservoir."""
        return self.cycles if by == "cycles" else float(getattr(self, f"{by}_kPa_per_s"))


def evaluate(robot: Robot, parts: PartsChoice) -> Evaluation:
    """Evaluate a choice of parts for a robot.

    Operating time, inflation, bandwidth and cycles are the paper's Eq. 3, 4, 7 and 8. The paper has no model
    of deflation; see `_deflation_curve`.
    """
    inlets = [valve.max_inlet_kPa.value for valve in (parts.evp, parts.dvp) if valve is not None]
    fill_kPa = min(robot.fill_kPa, parts.reservoir.max_kPa.value, *inlets)
    reservoir_kPa = np.linspace(0.0, fill_kPa, POINTS)
    resistance = parts.evp.resistance_kPa_s_per_SL
    volume_L, swing_kPa = parts.reservoir_volume_L, robot.swing_kPa
    wanted = robot.wanted_inflation_kPa_per_s
    more_air = robot.fill_SL / robot.rigid_fill_SL
    pouch_air = robot.pouch_fill_SL / robot.rigid_fill_SL

    def cycles(air: float) -> float:
        # A pouch needs more air for the same swing, so rate and swing of Eq. 8 are scaled by it.
        left = paper.n_cycles(
            fill_kPa,
            reservoir_volume_L=volume_L,
            cv_volume_L=robot.cv_volume_L,
            swing_kPa=swing_kPa * air,
            rate_kPa_per_s=wanted * air,
            flow_resistance_kPa_s_per_SL=resistance,
        )
        return max(left, 0.0)

    inflation = paper.inflation_rate_kPa_per_s(reservoir_kPa, resistance, robot.cv_volume_L) / more_air
    cycles_rigid, cycles_pouch = cycles(1.0), cycles(pouch_air)
    own_cycles = cycles_pouch if robot.cv_kind == "pouch" else cycles_rigid
    least_kPa = paper.min_reservoir_kPa(wanted, resistance, robot.cv_volume_L) * more_air
    tau_s = paper.discharge_time_constant_s(resistance, volume_L)
    deflation, passive = _deflation_curve(robot, parts, reservoir_kPa, more_air)
    return Evaluation(
        robot=robot,
        parts=parts,
        fill_kPa=fill_kPa,
        reservoir_kPa=reservoir_kPa,
        inflation_curve_kPa_per_s=inflation,
        deflation_curve_kPa_per_s=deflation,
        passive_kPa_per_s=passive,
        bandwidth_curve_Hz=paper.cutoff_Hz(inflation, swing_kPa / 2.0),
        least_kPa=least_kPa,
        cycles_rigid=cycles_rigid,
        cycles_pouch_air=cycles_rigid / pouch_air,
        cycles_pouch=cycles_pouch,
        cycles_passive=2.0 * own_cycles,
        full_open_s=tau_s * math.log(fill_kPa / least_kPa) if least_kPa < fill_kPa else 0.0,
        mass_kg=sum(part.mass_g.value * count for part, count in parts.each()) / 1000.0,
        mass_by_origin_kg=_mass_by_origin_kg(parts),
        power_W=_power_W(parts, passive >= robot.wanted_deflation_kPa_per_s),
    )


def _deflation_curve(
    robot: Robot, parts: PartsChoice, reservoir_kPa: Array, more_air: float
) -> tuple[Array, float]:
    """Mean speed of a deflation to `DEFLATED` of the swing, kPa/s: for each P_r, and passively.

    With Ohm's law of flow (paper, Eq. 2) passive venting is exponential, with τ = R_s V_cv / α of the
    solenoid. The suction of a Venturi falls linearly from Q_s at atmospheric pressure to 0 at its maximum
    vacuum b. In series with the solenoid, the pressure falls exponentially towards −b, through R_s + b / Q_s.
    The firmware uses the Venturi where it is faster. The additional air of a pouch increases the time in
    proportion.
    """
    high, low = robot.pressure_kPa, robot.pressure_kPa - (1.0 - DEFLATED) * robot.swing_kPa
    solenoid = parts.solenoid.flow_resistance_kPa_s_per_SL.value

    def speed(resistance: float, vacuum_kPa: float) -> float:
        tau_s = paper.discharge_time_constant_s(resistance, robot.cv_volume_L)
        return (high - low) / (tau_s * math.log((high + vacuum_kPa) / (low + vacuum_kPa))) / more_air

    passive = speed(solenoid, 0.0)
    curve = np.full_like(reservoir_kPa, passive)
    if parts.venturi is not None and parts.dvp is not None:
        for i, supply_kPa in enumerate(reservoir_kPa):
            vacuum_kPa, suction = _suction(parts.dvp, parts.venturi, float(supply_kPa), robot.ambient_kPa)
            if suction > 0.0 and vacuum_kPa > 0.0:
                curve[i] = max(passive, speed(solenoid + vacuum_kPa / suction, vacuum_kPa))
    return curve, passive


def _suction(
    dvp: ValvePart, venturi: VenturiPart, supply_kPa: float, ambient_kPa: float
) -> tuple[float, float]:
    """Maximum vacuum (kPa below ambient) and free suction (SL/s) of a Venturi behind a fully open DVP.

    The flows of two restrictions in series combine as 1/Q², which is nearer to choked flow than a sum of R_v.
    """
    nozzle = venturi.resistance_kPa_s_per_SL
    both = math.hypot(dvp.resistance_kPa_s_per_SL, nozzle)
    motive_kPa = supply_kPa * nozzle / both
    share = min(1.0, motive_kPa / venturi.full_vacuum_from_kPa.value)
    # A vacuum cannot be deeper than ambient pressure.
    vacuum_kPa = min(venturi.max_vacuum_fraction.value, 0.99) * ambient_kPa * share
    return vacuum_kPa, venturi.suction_per_consumption.value * paper.flow_SL_per_s(supply_kPa, both)


def _mass_by_origin_kg(parts: PartsChoice) -> dict[Origin, float]:
    masses: dict[Origin, float] = {"printed": 0.0, "computed": 0.0, "assumed": 0.0}
    for part, count in parts.each():
        masses[part.mass_g.origin] += part.mass_g.value * count / 1000.0
    return masses


def _power_W(parts: PartsChoice, passive: bool) -> float:
    def power(part: Part | None) -> float:
        return 0.0 if part is None or part.power_W is None else part.power_W.value

    always = sum(part.count * power(part) for part in parts.fixed)
    deflating = power(parts.solenoid) + (0.0 if passive else power(parts.dvp))
    return always + 0.5 * (power(parts.evp) + deflating)


# The search.


def choices(catalogue: Catalogue) -> Iterator[PartsChoice]:
    """Every choice of valves, Venturi (or none), solenoid and reservoirs, with the lightest fixed parts."""
    fixed, valves = catalogue.fixed(), catalogue.all(ValvePart)
    pumps: list[tuple[ValvePart | None, VenturiPart | None]] = [(None, None)]
    pumps += product(valves, catalogue.all(VenturiPart))
    for evp, (dvp, venturi), solenoid, reservoir, count in product(
        valves,
        pumps,
        catalogue.all(SolenoidPart),
        catalogue.all(ReservoirPart),
        range(1, MAX_RESERVOIRS + 1),
    ):
        yield PartsChoice(evp, reservoir, solenoid, fixed, dvp, venturi, count)


def evaluate_all(robot: Robot, catalogue: Catalogue) -> list[Evaluation]:
    """Evaluations of all choices, including those that miss a requirement."""
    return [evaluate(robot, parts) for parts in choices(catalogue)]


def front(evaluations: Sequence[Evaluation], by: Performance = "cycles") -> list[Evaluation]:
    """The Pareto front among the evaluations that meet all requirements, lightest first.

    Of equal evaluations only the first is in it.
    """
    meeting = [evaluation for evaluation in evaluations if not evaluation.missed]
    meeting.sort(key=lambda evaluation: (evaluation.mass_kg, -evaluation.performance(by)))
    found: list[Evaluation] = []
    for evaluation in meeting:
        if not found or evaluation.performance(by) > found[-1].performance(by):
            found.append(evaluation)
    return found


def search(robot: Robot, catalogue: Catalogue, by: Performance = "cycles") -> list[Evaluation]:
    """The Pareto front of mass and performance among the choices that meet a robot's requirements.

    Empty if no choice meets them; then see `Evaluation.missed` of `evaluate_all`.
    """
    return front(evaluate_all(robot, catalogue), by)
