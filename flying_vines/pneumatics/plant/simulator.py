"""A plant that lives, one tick of the firmware after the other.

Within a tick what the valves are driven to holds, and the gas is integrated by classical Runge–Kutta in as
many equal steps as the quickest part needs, more of them after a jump. Where the law has a kink or jump (a
pouch becomes full, the Venturi stalls) the step is divided.
"""

from __future__ import annotations

from math import ceil

from flying_vines.pneumatics.baseline import Inputs
from flying_vines.pneumatics.plant.coil import Coil, current_A, temperature_after_K
from flying_vines.pneumatics.plant.motion import (
    ValveMotion,
    backlash,
    dead_zone,
    delayed,
    solenoid_after,
    ticks,
)
from flying_vines.pneumatics.plant.plant import Conditions, Held, Plant, State, at_rest
from flying_vines.pneumatics.plant.rates import Floats, RateFunction, fastest_rate_per_s, model_of

TICK_S = 0.001
SHUT = Inputs(0.0, 0.0, False)
_LONGEST_STEP = 1.25
"""In quickest time constants; Runge–Kutta is stable to 2.8."""
_SHORT_STEP = 0.25
"""So short a step needs no finer ones."""
_FINER = 3
_FINE_TICKS = 2
_JUMP = 0.25
"""So much finer, and so long, after a jump of a valve, a turn of the solenoid, or an edge."""
_MOST_PARTS = 3
"""How often a step is divided: as often as a plant has edges."""


class Simulator:
    """`advance` by ticks with the firmware's commands; ask `conditions` in between.

    `initial` is what the delays still hold of before; lag starts from the state, play closed, coils at the
    ambient temperature. The same plant, state and commands give the same floats.
    """

    def __init__(
        self,
        plant: Plant,
        state: State | None = None,
        *,
        initial: Inputs = SHUT,
        t_s: float = 0.0,
        tick_s: float = TICK_S,
    ) -> None:
        self.plant = plant
        self.model = model_of(plant)
        self.state = at_rest(plant, t_s=t_s) if state is None else state
        quickest = fastest_rate_per_s(plant) * tick_s
        self.steps_per_tick = max(1, ceil(quickest / _LONGEST_STEP))
        self._finer = _FINER if quickest / self.steps_per_tick > _SHORT_STEP else 1
        self.held = Held(0.0, 0.0, False)
        """What held during the last tick."""
        effects = plant.effects
        self._tick_s = tick_s
        self._start_s = t_s
        self._ticks = 0
        ambient_K = plant.ambient.at(t_s)[1]
        self._evp = _Valve(effects.evp_motion, effects.evp_coil, initial.evp, ambient_K, tick_s)
        self._dvp = _Valve(effects.dvp_motion, effects.dvp_coil, initial.dvp, ambient_K, tick_s)
        timing = effects.solenoid_timing
        self._opening_ticks = ticks(timing.opening_s, tick_s) if timing else 0
        self._closing_ticks = ticks(timing.closing_s, tick_s) if timing else 0
        self._solenoid = (bool(initial.solenoid), 0)
        # The first edge is a constant when the Venturi does not stall.
        stalls = effects.ejector is not None and effects.ejector.stall_supply_kPa > 0.0
        self._has_edges = stalls or len(self.model.edges(t_s, self.state)) > 1
        self._fine_ticks = 0
        self._coils = effects.evp_coil is not None or effects.dvp_coil is not None

    @property
    def t_s(self) -> float:
        return self._start_s + self._ticks * self._tick_s

    @property
    def conditions(self) -> Conditions:
        """Pressures and temperatures now."""
        return self.model.conditions(self.t_s, self.state)

    @property
    def evp_coil_K(self) -> float:
        return self._evp.coil_K

    @property
    def dvp_coil_K(self) -> float:
        return self._dvp.coil_K

    def advance(self, command: Inputs) -> None:
        """One tick, for which the firmware commands this."""
        t_s, dt_s = self.t_s, self._tick_s
        ambient_K = self.plant.ambient.at(t_s)[1] if self._coils else 0.0
        evp = self._evp.follow(command.evp, ambient_K)
        dvp = self._dvp.follow(command.dvp, ambient_K)
        self._solenoid = solenoid_after(
            *self._solenoid, bool(command.solenoid), self._opening_ticks, self._closing_ticks
        )
        rates, state = self.model.derivatives, self.state
        edges = self.model.edges(t_s, state) if self._has_edges else ()
        held = Held(evp, dvp, self._solenoid[0], self._has_edges and edges[0] < 0.0)
        before = self.held
        if (
            held.solenoid_open != before.solenoid_open
            or abs(evp - before.evp_target) > _JUMP
            or abs(dvp - before.dvp_target) > _JUMP
        ):
            self._fine_ticks = _FINE_TICKS
        step_s = dt_s / self.steps_per_tick
        for index in range(self.steps_per_tick):
            at_s = t_s + index * step_s
            parts = self._finer if self._fine_ticks > 0 else 1
            part_s = step_s / parts
            for part in range(parts):
                if self._has_edges:
                    state, held, edges = self._step_by_edges(at_s + part * part_s, state, held, part_s, edges)
                else:
                    state = _step(rates, at_s + part * part_s, state, held, part_s)
        if self._fine_ticks > 0:
            self._fine_ticks -= 1
        self._ticks += 1
        self.held = held
        # An opening without lag is not integrated, but it is to be read.
        if not self._evp.lags or not self._dvp.lags:
            state = state._replace(
                evp_opening=state.evp_opening if self._evp.lags else evp,
                dvp_opening=state.dvp_opening if self._dvp.lags else dvp,
            )
        self.state = state

    def _step_by_edges(
        self, t_s: float, state: State, held: Held, step_s: float, edges: Floats, depth: int = 0
    ) -> tuple[State, Held, Floats]:
        """One step, in parts where it passes an edge: Runge–Kutta over a jump is no better than Euler."""
        model = self.model
        after = _step(model.derivatives, t_s, state, held, step_s)
        found = model.edges(t_s + step_s, after)
        shares = [a / (a - b) for a, b in zip(edges, found, strict=True) if (a < 0.0) != (b < 0.0)]
        if not shares or depth == _MOST_PARTS:
            return after, held._replace(venturi_stalled=found[0] < 0.0), found
        self._fine_ticks = _FINE_TICKS
        # Just beyond the edge, so that the rest of the step is on the other side.
        part_s = step_s * min(1.0, min(shares) + 1e-6)
        state = _step(model.derivatives, t_s, state, held, part_s)
        t_s, step_s = t_s + part_s, (step_s - part_s) / self._finer
        edges = model.edges(t_s, state)
        held = held._replace(venturi_stalled=edges[0] < 0.0)
        for index in range(self._finer):
            at_s = t_s + index * step_s
            state, held, edges = self._step_by_edges(at_s, state, held, step_s, edges, depth + 1)
        return state, held, edges


class _Valve:
    """From a command to where the valve is driven."""

    def __init__(
        self, motion: ValveMotion | None, coil: Coil | None, initial: float, ambient_K: float, tick_s: float
    ) -> None:
        self.coil_K = ambient_K
        self.lags = motion is not None and motion.time_constant_s > 0.0
        self._motion = motion
        self._coil = coil
        self._tick_s = tick_s
        self._passed_on = 0.0
        self._line = (initial,) * ticks(motion.delay_s, tick_s) if motion else ()

    def follow(self, command: float, ambient_K: float) -> float:
        """The target of this tick."""
        self._line, command = delayed(self._line, command)
        coil, motion = self._coil, self._motion
        if coil is not None:
            current = current_A(coil, command, self.coil_K)
            self.coil_K = temperature_after_K(coil, self.coil_K, current, ambient_K, self._tick_s)
            command = current / coil.full_current_A
        if motion is not None:
            if motion.backlash_width > 0.0:
                command = self._passed_on = backlash(self._passed_on, command, motion.backlash_width)
            return dead_zone(command, motion.dead_opening)
        return min(1.0, command)


def _step(rates: RateFunction, t_s: float, state: State, held: Held, dt_s: float) -> State:
    """Classical Runge–Kutta. Written out: loops over ten numbers cost more than the numbers."""
    half_s = dt_s / 2.0
    s0, s1, s2, s3, s4, s5, s6, s7, s8, s9 = state
    a0, a1, a2, a3, a4, a5, a6, a7, a8, a9 = rates(t_s, state, held)
    h = half_s
    middle: Floats = (
        s0 + h * a0, s1 + h * a1, s2 + h * a2, s3 + h * a3, s4 + h * a4,
        s5 + h * a5, s6 + h * a6, s7 + h * a7, s8 + h * a8, s9 + h * a9,
    )  # fmt: skip
    b0, b1, b2, b3, b4, b5, b6, b7, b8, b9 = rates(t_s + half_s, middle, held)
    middle = (
        s0 + h * b0, s1 + h * b1, s2 + h * b2, s3 + h * b3, s4 + h * b4,
        s5 + h * b5, s6 + h * b6, s7 + h * b7, s8 + h * b8, s9 + h * b9,
    )  # fmt: skip
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9 = rates(t_s + half_s, middle, held)
    h = dt_s
    last: Floats = (
        s0 + h * c0, s1 + h * c1, s2 + h * c2, s3 + h * c3, s4 + h * c4,
        s5 + h * c5, s6 + h * c6, s7 + h * c7, s8 + h * c8, s9 + h * c9,
    )  # fmt: skip
    d0, d1, d2, d3, d4, d5, d6, d7, d8, d9 = rates(t_s + dt_s, last, held)
    h = dt_s / 6.0
    return State(
        s0 + h * (a0 + 2.0 * (b0 + c0) + d0),
        s1 + h * (a1 + 2.0 * (b1 + c1) + d1),
        s2 + h * (a2 + 2.0 * (b2 + c2) + d2),
        s3 + h * (a3 + 2.0 * (b3 + c3) + d3),
        s4 + h * (a4 + 2.0 * (b4 + c4) + d4),
        s5 + h * (a5 + 2.0 * (b5 + c5) + d5),
        s6 + h * (a6 + 2.0 * (b6 + c6) + d6),
        s7 + h * (a7 + 2.0 * (b7 + c7) + d7),
        s8 + h * (a8 + 2.0 * (b8 + c8) + d8),
        s9 + h * (a9 + 2.0 * (b9 + c9) + d9),
    )
