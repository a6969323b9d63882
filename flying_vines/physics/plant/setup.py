"""A plant and its two sensors. A rig file describes a setup, an effect changes it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.plant import Plant
from flying_vines.physics.plant.sensors import Sensor
from flying_vines.physics.rig import Rig


@dataclass(frozen=True)
class Setup:
    """A plant and its sensors."""

    plant: Plant
    cv_sensor: Sensor
    reservoir_sensor: Sensor

    def with_rig(self, **tables: Any) -> Setup:
        """This setup with other tables of the rig, such as `cv`."""
        return replace(self, plant=replace(self.plant, rig=replace(self.plant.rig, **tables)))

    def with_effects(self, **parts: Any) -> Setup:
        """This setup with these fields of `Effects`.

        If the existing effect has every parameter that the new one sets, only these parameters change. If
        not, the new effect replaces the existing one. A parameter is set if it differs from its default.
        """
        there = self.plant.effects
        merged = {name: _merged(getattr(there, name), part) for name, part in parts.items()}
        return replace(self, plant=replace(self.plant, effects=replace(there, **merged)))


def perfect(rig: Rig, effects: Effects | None = None) -> Setup:
    """The rig with these effects (default: none). Its sensors have the rig's noise and no other error."""
    return Setup(
        Plant(rig, effects or Effects()),
        Sensor(206.84, noise_std_kPa=rig.sensors.cv_noise_std_kPa),
        Sensor(1500.0, noise_std_kPa=rig.sensors.reservoir_noise_std_kPa),
    )


def changed(part: Any) -> dict[str, Any]:
    """The fields of a dataclass that differ from their defaults."""
    return {f.name: v for f in fields(part) if (v := getattr(part, f.name)) != f.default}


def _merged(old: Any, new: Any) -> Any:
    given = changed(new)
    return replace(old, **given) if old is not None and all(hasattr(old, name) for name in given) else new
