"""A plant and its two sensors: what a rig file describes, and what an effect changes."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.plant import Plant
from flying_vines.physics.plant.sensors import Sensor
from flying_vines.physics.rig import Rig


@dataclass(frozen=True)
class Setup:
    """A plant and what reads it."""

    plant: Plant
    cv_sensor: Sensor
    reservoir_sensor: Sensor

    def with_rig(self, **tables: Any) -> Setup:
        """The same with other tables of the rig, as `cv`."""
        return replace(self, plant=replace(self.plant, rig=replace(self.plant.rig, **tables)))

    def with_effects(self, **parts: Any) -> Setup:
        """The same with these fields of `Effects`.

        A part that is there already keeps what the new one leaves at its defaults, if it has the same
        parameters.
        """
        there = self.plant.effects
        merged = {name: _merged(getattr(there, name), part) for name, part in parts.items()}
        return replace(self, plant=replace(self.plant, effects=replace(there, **merged)))


def perfect(rig: Rig, effects: Effects | None = None) -> Setup:
    """The rig with these effects (none if not given); its sensors have the rig's noise."""
    return Setup(
        Plant(rig, effects or Effects()),
        Sensor(206.84, noise_std_kPa=rig.sensors.cv_noise_std_kPa),
        Sensor(1500.0, noise_std_kPa=rig.sensors.reservoir_noise_std_kPa),
    )


def changed(part: Any) -> dict[str, Any]:
    """What of a description is not as its defaults have it."""
    return {f.name: v for f in fields(part) if (v := getattr(part, f.name)) != f.default}


def _merged(old: Any, new: Any) -> Any:
    says = changed(new)
    return replace(old, **says) if old is not None and all(hasattr(old, name) for name in says) else new
