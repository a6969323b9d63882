"""We as a component of the vehicle: what ground stations expect of one, and the manners that go with it."""

from flying_vines.vehicle.component.component import Component

__all__ = ["Component"]
