"""A plant and its two sensors. A rig file describes a setup, an effect changes it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.plant import Plant
from flying_vines.physics.plant.sensors import Sensor
from flying_vines.physics.rig import Rig, Vessel


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
