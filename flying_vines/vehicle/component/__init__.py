"""Our MAVLink component on the vehicle, with everything that ground stations expect of a component."""

from flying_vines.vehicle.component.component import Component

__all__ = ["Component"]
