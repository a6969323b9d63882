"""Simulates a plant tick by tick of the firmware."""

from __future__ import annotations

from collections import deque

from flying_vines.physics.baseline import Inputs
from flying_vines.physics.gas import STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.ambient import Steady, air_at, air_between
from flying_vines.physics.plant.numbers import PlantNumbers, numbers_of
from flying_vines.physics.plant.plant import Conditions, Held, Plant, State, at_rest
from flying_vines.physics.plant.rates import conditions
from flying_vines.physics.plant.tick import memory_at_rest, tick

TICK_S = 0.001
SHUT = Inputs(0.0, 0.0, False)


class Simulator:
    """`advance` runs one tick with the firmware's commands; `conditions` are the true values.

    `initial` are the commands before the start, for the solenoid and for valves with a delay. Lags start from
    the state, backlash from a shut valve, coils from ambient temperature. The same plant, state and commands
    give the same floats. `numbers` and `state` may be replaced between ticks.
    """

    def __init__(
        self,
        plant: Plant,
        state: State | None = None,
        *,
        initial: Inputs = SHUT,
        tick_s: float = TICK_S,
    ) -> None:
        self.plant = plant
        self.numbers = numbers_of(plant, tick_s)
        self.state = at_rest(plant) if state is None else state
        self._ticks = 0
        self._steady = isinstance(plant.ambient, Steady)
        self._air = air_at(plant.ambient, 0.0)
        self._memory = memory_at_rest(bool(initial.solenoid), self._air.ratio * STANDARD_TEMPERATURE_K)
        self._evp_line = deque((initial.evp,) * self.numbers.evp.delay_ticks)
        self._dvp_line = deque((initial.dvp,) * self.numbers.dvp.delay_ticks)
        # The inputs of the last tick, if it changed nothing.
        self._at_rest: tuple[PlantNumbers, State, float, float, bool] | None = None

    @property
    def t_s(self) -> float:
        return self._ticks * self.numbers.tick_s

    @property
    def conditions(self) -> Conditions:
        """Pressures and temperatures now."""
        return conditions(self.numbers, self._air, self.state)

    @property
    def held(self) -> Held:
        """Valve targets and Venturi state during the last tick."""
        memory = self._memory
        return Held(memory.evp.target, memory.dvp.target, memory.solenoid_open, memory.venturi_stalled)

    def advance(self, command: Inputs) -> bool:
        """Run one tick with this command. False if the last tick had the same inputs and changed nothing."""
        evp, dvp, solenoid = command
        if self._evp_line:
            self._evp_line.append(evp)
            evp = self._evp_line.popleft()
        if self._dvp_line:
            self._dvp_line.append(dvp)
            dvp = self._dvp_line.popleft()
        self._ticks += 1
        air = during = self._air
        if not self._steady:
            air = air_at(self.plant.ambient, self.t_s)
            during = air_between(self._air, air, self.numbers.tick_s)
        open_command = bool(solenoid)
        given = (self.numbers, self.state, evp, dvp, open_command)
        # This saves time, because a vine mostly waits.
        if given == self._at_rest:
            return False
        memory, state = tick(self.numbers, during, self._memory, self.state, evp, dvp, open_command)
        resting = self._steady and state == self.state and memory == self._memory
        self._at_rest = given if resting else None
        self._memory = memory
        self._air = air
        self.state = State._make(state)
        return True
