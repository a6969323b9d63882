"""One tick of the firmware: moves the valves, then integrates the gas.

The targets of the valves are constant within a tick. The gas is integrated by classical Runge-Kutta, in as
many equal steps as the fastest rate needs; after a jump the steps are finer. A step ends at a kink or jump of
the rates (a bending pouch becomes full, the Venturi stalls).
"""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

from flying_vines.physics.gas import STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.ambient import Air
from flying_vines.physics.plant.numbers import PlantNumbers, ValveNumbers
from flying_vines.physics.plant.plant import Held
from flying_vines.physics.plant.rates import Floats, edges, quickest_per_s, rates
from flying_vines.physics.plant.valve_response import (
    backlash,
    current_A,
    dead_zone,
    opening_after,
    opening_midway,
    solenoid_after,
    temperature_after_K,
    warmth_after,
)

_MAX_STEP = 2.3
"""Maximum step, in units of the fastest time constant. Runge-Kutta is stable up to 2.8."""
_SHORT_STEP = 0.25
"""A step below this, in units of the fastest time constant, needs no refinement."""
_FINER = 3
"""Refinement factor after a valve jump, a solenoid switch, or an edge."""
_FINE_TICKS = 3
"""Number of ticks with refined steps."""
_JUMP = 0.1
"""Change of a valve's target that counts as a jump."""
_ARRIVED = 1e-9
"""An opening nearer than this to its target is set to the target."""
_GRAZE = 1e-7
"""A change of sign by less than this (kPa, kPa·L) does not count as crossing an edge."""
_MAX_PARTS = 3
"""Maximum number of times that a tick is divided at edges: a plant has three edges."""


class ValveMemory(NamedTuple):
    """State of a valve between ticks."""

    target: float
    passed_on: float
    """Command after the backlash."""
    coil_K: float
    warmth: float
    """See `ValveMotion.heating_share`."""


class Memory(NamedTuple):
    """State of everything except the gas."""

    evp: ValveMemory
    dvp: ValveMemory
    solenoid_open: bool
    solenoid_waited_ticks: int
    venturi_stalled: bool
    fine_ticks: int


def memory_at_rest(solenoid_open: bool, ambient_K: float) -> Memory:
    """Valves shut, coils at ambient temperature."""
    valve = ValveMemory(0.0, 0.0, ambient_K, 0.0)
    return Memory(valve, valve, solenoid_open, 0, False, 0)


def tick(
    numbers: PlantNumbers, air: Air, memory: Memory, state: Floats, evp: float, dvp: float, solenoid: bool
) -> tuple[Memory, Floats]:
    """Memory and state one tick later.

    `evp`, `dvp`: commands after their delays. `solenoid`: its command. `air`: ambient air during the tick.
    """
    tick_s = numbers.tick_s
    evp_now = _follow(numbers.evp, memory.evp, evp, air, tick_s)
    dvp_now = _follow(numbers.dvp, memory.dvp, dvp, air, tick_s)
    solenoid_open, waited = solenoid_after(
        memory.solenoid_open,
        memory.solenoid_waited_ticks,
        solenoid,
        numbers.solenoid_opening_ticks,
        numbers.solenoid_closing_ticks,
    )
    seen = edges(numbers, air, 0.0, state) if numbers.has_edges else (1.0, 1.0, 1.0)
    held = Held(evp_now.target, dvp_now.target, solenoid_open, seen[0] < 0.0)
    fine_ticks = memory.fine_ticks
    if (
        solenoid_open != memory.solenoid_open
        or abs(evp_now.target - memory.evp.target) > _JUMP
        or abs(dvp_now.target - memory.dvp.target) > _JUMP
    ):
        fine_ticks = _FINE_TICKS
    quickest = quickest_per_s(numbers, air, state, held) * tick_s
    steps = max(1, ceil(quickest / _MAX_STEP))
    if fine_ticks > 0 and quickest > _SHORT_STEP * steps:
        steps *= _FINER
    step_s = tick_s / steps

    if not numbers.has_edges:
        for index in range(steps):
            state = runge_kutta(numbers, air, index * step_s, state, held, step_s)
    else:
        divided = 0
        done_s = 0.0
        # A remainder below this is rounding error.
        while tick_s - done_s > 1e-9 * tick_s:
            part_s = min(step_s, tick_s - done_s)
            after = runge_kutta(numbers, air, done_s, state, held, part_s)
            found = edges(numbers, air, done_s + part_s, after)
            share = _first_crossing(seen, found)
            # Runge-Kutta over a jump is only as accurate as Euler: repeat the step up to the edge.
            if share < 1.0 and divided < _MAX_PARTS:
                divided += 1
                fine_ticks = _FINE_TICKS
                # The step ends just beyond the edge, so that the next step begins on the other side.
                part_s *= min(1.0, share + 1e-6)
                after = runge_kutta(numbers, air, done_s, state, held, part_s)
                found = edges(numbers, air, done_s + part_s, after)
                step_s = min(step_s, tick_s - done_s - part_s) / _FINER
            done_s += part_s
            state = after
            seen = found
            held = Held(held.evp_target, held.dvp_target, held.solenoid_open, seen[0] < 0.0)

    s0, s1, s2, s3, s4, s5, s6, s7, s8, s9 = state
    if abs(s7 - evp_now.target) < _ARRIVED:
        s7 = evp_now.target
    if abs(s8 - dvp_now.target) < _ARRIVED:
        s8 = dvp_now.target
    fine_ticks = max(0, fine_ticks - 1)
    return (
        Memory(evp_now, dvp_now, solenoid_open, waited, held.venturi_stalled, fine_ticks),
        (s0, s1, s2, s3, s4, s5, s6, s7, s8, s9),
    )


def _follow(valve: ValveNumbers, memory: ValveMemory, command: float, air: Air, tick_s: float) -> ValveMemory:
    """The valve's memory with its target for this tick."""
    coil_K = memory.coil_K
    if valve.stuck_opening >= 0.0:
        return ValveMemory(valve.stuck_opening, memory.passed_on, coil_K, memory.warmth)
    if valve.has_coil:
        current = current_A(valve.coil, command, coil_K)
        ambient_K = air.ratio * STANDARD_TEMPERATURE_K
        coil_K = temperature_after_K(valve.coil, coil_K, current, ambient_K, tick_s)
        command = current / valve.coil.full_current_A
    warmth = midway = 0.0
    if valve.motion.heating_share > 0.0:
        warmth = warmth_after(valve.motion, memory.warmth, command, tick_s)
        midway = 0.5 * (memory.warmth + warmth)
    command = backlash(memory.passed_on, command, valve.motion.backlash_width)
    target = dead_zone(command, valve.motion.dead_opening) * (1.0 - valve.motion.heating_share * midway)
    return ValveMemory(target, command, coil_K, warmth)


def _first_crossing(before: tuple[float, float, float], after: tuple[float, float, float]) -> float:
    """The share of a step at which the first edge is crossed; 1 if none is."""
    share = 1.0
    for index in range(3):
        a, b = before[index], after[index]
        if (a < 0.0) != (b < 0.0) and abs(a - b) > _GRAZE:
            share = min(share, a / (a - b))
    return share


def runge_kutta(
    numbers: PlantNumbers, air: Air, at_s: float, state: Floats, held: Held, dt_s: float
) -> Floats:
    """The classical Runge-Kutta step of the gas; openings with a lag are exact.

    The stages are written out because loops would be slower.
    """
    h = dt_s / 2.0
    s0, s1, s2, s3, s4, s5, s6, s7, s8, s9 = state
    evp = opening_midway(numbers.evp.lag_per_s, s7, held.evp_target, dt_s)
    dvp = opening_midway(numbers.dvp.lag_per_s, s8, held.dvp_target, dt_s)
    a0, a1, a2, a3, a4, a5, a6, _, _, a9 = rates(numbers, air, at_s, state, held)
    middle = (
        s0 + h * a0, s1 + h * a1, s2 + h * a2, s3 + h * a3, s4 + h * a4, s5 + h * a5, s6 + h * a6,
        evp, dvp, s9,
    )  # fmt: skip
    b0, b1, b2, b3, b4, b5, b6, _, _, b9 = rates(numbers, air, at_s + h, middle, held)
    middle = (
        s0 + h * b0, s1 + h * b1, s2 + h * b2, s3 + h * b3, s4 + h * b4, s5 + h * b5, s6 + h * b6,
        evp, dvp, s9,
    )  # fmt: skip
    c0, c1, c2, c3, c4, c5, c6, _, _, c9 = rates(numbers, air, at_s + h, middle, held)
    h = dt_s
    evp = opening_after(numbers.evp.lag_per_s, s7, held.evp_target, dt_s)
    dvp = opening_after(numbers.dvp.lag_per_s, s8, held.dvp_target, dt_s)
    last = (
        s0 + h * c0, s1 + h * c1, s2 + h * c2, s3 + h * c3, s4 + h * c4, s5 + h * c5, s6 + h * c6,
        evp, dvp, s9,
    )  # fmt: skip
    d0, d1, d2, d3, d4, d5, d6, _, _, d9 = rates(numbers, air, at_s + h, last, held)
    h = dt_s / 6.0
    return (
        s0 + h * (a0 + 2.0 * (b0 + c0) + d0),
        s1 + h * (a1 + 2.0 * (b1 + c1) + d1),
        s2 + h * (a2 + 2.0 * (b2 + c2) + d2),
        s3 + h * (a3 + 2.0 * (b3 + c3) + d3),
        s4 + h * (a4 + 2.0 * (b4 + c4) + d4),
        s5 + h * (a5 + 2.0 * (b5 + c5) + d5),
        s6 + h * (a6 + 2.0 * (b6 + c6) + d6),
        evp,
        dvp,
        s9 + h * (a9 + 2.0 * (b9 + c9) + d9),
    )
