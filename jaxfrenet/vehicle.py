"""The ego vehicle: dimensions and limits of the kinematic single-track model."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Vehicle:
    """A vehicle of the CommonRoad vehicle models (Althoff et al. 2017), in SI units and radians.

    The planner's reference point is the rear axle; boxes for collision are placed at the vehicle's centre, which lies
    `rear_axle_to_center` ahead of it.
    """

    length: float
    width: float
    rear_axle_to_center: float
    front_axle_to_center: float
    mass: float
    max_steering_angle: float
    max_steering_rate: float
    max_speed: float
    switching_speed: float
    """Speed above which the engine limits the acceleration to `max_acceleration * switching_speed / speed`."""
    max_acceleration: float
    commonroad_name: str
    """The vehicle's name in CommonRoad solution files."""

    @property
    def wheelbase(self) -> float:
        """Distance between the axles [m]."""
        return self.rear_axle_to_center + self.front_axle_to_center

    @property
    def max_curvature(self) -> float:
        """Curvature of the rear axle's path at full steering angle [1/m]."""
        return math.tan(self.max_steering_angle) / self.wheelbase


FORD_ESCORT = Vehicle(
    length=4.298,
    width=1.674,
    front_axle_to_center=0.88392,
    rear_axle_to_center=1.50876,
    mass=1225.888,
    max_steering_angle=0.91,
    max_steering_rate=0.4,
    max_speed=45.8,
    switching_speed=4.755,
    max_acceleration=11.5,
    commonroad_name="FORD_ESCORT",
)
BMW_320I = Vehicle(
    length=4.508,
    width=1.610,
    front_axle_to_center=1.1561957064,
    rear_axle_to_center=1.4227170936,
    mass=1093.2952334674046,
    max_steering_angle=1.066,
    max_steering_rate=0.4,
    max_speed=50.8,
    switching_speed=7.319,
    max_acceleration=11.5,
    commonroad_name="BMW_320i",
)
VW_VANAGON = Vehicle(
    length=4.569,
    width=1.844,
    front_axle_to_center=1.1507916024,
    rear_axle_to_center=1.3211363976,
    mass=1478.898,
    max_steering_angle=1.023,
    max_steering_rate=0.4,
    max_speed=41.7,
    switching_speed=7.824,
    max_acceleration=11.5,
    commonroad_name="VW_VANAGON",
)
