"""A plant: a rig with effects, and its state. A plant and its two sensors are a setup."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

from flying_vines.physics.gas import ALPHA_KPA, STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.ambient import Ambient, Steady
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.sensors import Sensor
from flying_vines.physics.plant.volume import Compliant, Shape, volume_and_work
from flying_vines.physics.rig import Hose, Rig, Vessel


@dataclass(frozen=True)
class Plant:
    """A rig with effects. Without effects it is the baseline."""

    rig: Rig = field(default_factory=Rig)
    effects: Effects = field(default_factory=Effects)

    def __post_init__(self) -> None:
        if self.rig.cv is not None:
            self.shape.numbers(self.rig.cv.volume_L, 0.0)

    @property
    def ambient(self) -> Ambient:
        return Steady() if self.effects.ambient is None else self.effects.ambient

    @property
    def tubing(self) -> Hose | None:
        """The tube before the control volume: the tubing of the effects, or else the hose of the rig."""
        return self.effects.tubing or self.rig.hose

    @property
    def shape(self) -> Shape:
        """Shape of the control volume; rigid by default."""
        shape = self.effects.cv_shape
        return Compliant() if shape is None or self.rig.cv is None else shape

    @property
    def cv_volume_L(self) -> float:
        """Nominal volume of the control volume; 1 L, into which nothing flows, if the rig has none."""
        return 1.0 if self.rig.cv is None else self.rig.cv.volume_L


class State(NamedTuple):
    """The integrated state.

    `reservoir_pV_J` is absolute pressure times volume, which is (γ − 1) times the internal energy.
    `cv_energy_J` is pV plus (γ − 1) times the work done on wall and ambient (see `volume.py`). Numbers of
    absent effects are constant and have no meaning: pV of isothermal gas, a wall at ambient temperature, the
    line without tubing, an opening without lag. `vented_SL` is the net air that has left to ambient.
    """

    reservoir_air_SL: float
    reservoir_pV_J: float
    reservoir_wall_K: float
    cv_air_SL: float
    cv_energy_J: float
    cv_wall_K: float
    line_air_SL: float
    evp_opening: float
    dvp_opening: float
    vented_SL: float


class Held(NamedTuple):
    """Constant during one integration step: the targets of the valves, and the state of the Venturi.

    The targets, with the solenoid, are constant during a whole tick.
    """

    evp_target: float
    dvp_target: float
    solenoid_open: bool
    venturi_stalled: bool = False


class Conditions(NamedTuple):
    """True values at an instant: kPa gauge (ambient: absolute), K, L."""

    reservoir_kPa: float
    cv_kPa: float
    line_kPa: float
    reservoir_K: float
    cv_K: float
    cv_volume_L: float
    ambient_kPa: float
    ambient_K: float


def air_SL(pressure_kPa_abs: float, volume_L: float, temperature_K: float = STANDARD_TEMPERATURE_K) -> float:
    """Standard litres in a volume: n = p V / (α θ), the ideal gas law."""
    return pressure_kPa_abs * volume_L * STANDARD_TEMPERATURE_K / (ALPHA_KPA * temperature_K)


def at_rest(
    plant: Plant,
    reservoir_kPa: float = 690.0,
    cv_kPa: float = 0.0,
    *,
    t_s: float = 0.0,
    pouch_volume_L: float | None = None,
) -> State:
    """The state with all valves shut, at ambient temperature, with these gauge pressures.

    `pouch_volume_L` is the volume of the actuator's bending pouch at 0 kPa; default: flat. A rig with a pump
    has no reservoir, and `reservoir_kPa` then has no meaning.
    """
    g = plant.rig.gas.properties.gamma - 1.0
    ambient_kPa, ambient_K, _ = plant.ambient.at(t_s)
    chamber = plant.shape.numbers(plant.cv_volume_L, g)
    volume_L, work_J = volume_and_work(chamber, cv_kPa, ambient_kPa, pouch_volume_L or 0.0)
    if plant.rig.pump is not None:
        reservoir_kPa = 0.0
    reservoir_kPa_abs, cv_kPa_abs = reservoir_kPa + ambient_kPa, cv_kPa + ambient_kPa
    line_L = plant.tubing.volume_L if plant.tubing else 0.0
    return State(
        air_SL(reservoir_kPa_abs, plant.rig.reservoir.volume_L, ambient_K),
        reservoir_kPa_abs * plant.rig.reservoir.volume_L,
        ambient_K,
        air_SL(cv_kPa_abs, volume_L, ambient_K),
        cv_kPa_abs * volume_L + g * work_J,
        ambient_K,
        air_SL(cv_kPa_abs, line_L, ambient_K),
        0.0,
        0.0,
        0.0,
    )


@dataclass(frozen=True)
class Setup:
    """A plant and its sensors."""

    plant: Plant
    cv_sensor: Sensor
    reservoir_sensor: Sensor

    def with_rig(self, **tables: Any) -> Setup:
        """This setup with other tables of the rig, such as `cv`."""
        return replace(self, plant=replace(self.plant, rig=replace(self.plant.rig, **tables)))

    def with_sensor(self, vessel: Vessel, **errors: float) -> Setup:
        """This setup with these errors of the sensor of `vessel`."""
        name = f"{vessel}_sensor"
        return replace(self, **{name: replace(getattr(self, name), **errors)})

    def with_effects(self, **parts: Any) -> Setup:
        """This setup with these fields of `Effects`. An effect replaces the existing one.

        A `partial` of an effect, such as `partial(ValveMotion, delay_s=0.01)`, changes only the named
        parameters if the existing effect has them all. If not, it replaces the existing one.
        """
        there = self.plant.effects
        made = {
            name: _changed(getattr(there, name), part) if isinstance(part, partial) else part
            for name, part in parts.items()
        }
        return replace(self, plant=replace(self.plant, effects=replace(there, **made)))


def perfect(rig: Rig, effects: Effects | None = None) -> Setup:
    """The rig with these effects (default: none). Its sensors have the rig's noise and no other error."""
    return Setup(
        Plant(rig, effects or Effects()),
        Sensor(206.84, noise_std_kPa=rig.sensors.cv_noise_std_kPa),
        Sensor(1500.0, noise_std_kPa=rig.sensors.reservoir_noise_std_kPa),
    )


def _changed(old: Any, part: partial[Any]) -> Any:
    has_them = old is not None and all(hasattr(old, name) for name in part.keywords)
    return replace(old, *part.args, **part.keywords) if has_them else part()
