"""Home and speeds of the vehicle that mission planning assumes and that the stand-ins fly."""

from __future__ import annotations

import math
from dataclasses import dataclass

CRUISE_M_S = 5.0
VERTICAL_M_S = 2.5
TOUCHDOWN_M_S = 0.5
FLARE_HEIGHT_M = 2.0

_METRES_PER_DEGREE = 111_318.84


@dataclass(frozen=True, slots=True)
class Home:
    """The place where the vehicle was switched on: the origin of its local coordinates."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float

    def local_m(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """North and east of home, on a plane."""
        shrink = math.cos(math.radians(self.latitude_deg))
        return (
            (latitude_deg - self.latitude_deg) * _METRES_PER_DEGREE,
            (longitude_deg - self.longitude_deg) * _METRES_PER_DEGREE * shrink,
        )

    def global_deg(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Latitude and longitude of a point of the plane."""
        shrink = math.cos(math.radians(self.latitude_deg))
        return (
            self.latitude_deg + north_m / _METRES_PER_DEGREE,
            self.longitude_deg + east_m / (_METRES_PER_DEGREE * shrink),
        )


ARDUPILOT_HOME = Home(-35.363262, 149.165237, 584.09)
"""Home of ArduPilot's SITL."""
PX4_HOME = Home(47.3977431, 8.5455944, 489.443)
"""Home of PX4's SITL."""
