"""Settings of the planner and of the closed loop that shape the compiled program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from jaxfrenet.vehicle import BMW_320I, Vehicle

DT = 0.1
"""Time step [s] of scenarios, trajectories and the closed loop."""
Sampling = Literal["fast", "full", "dense"]
"""Names of sampling levels: for training on a CPU, the paper's own, and a finer one."""
SAMPLING_LEVELS: dict[str, int] = {"fast": 1, "full": 2, "dense": 3}
"""They stand for 180, 800 and 3,564 trajectories."""
LONGEST_HORIZON = 250
"""Most time steps that a trajectory can look ahead."""
HarmModel = Literal["symmetric_areas", "angle_free"]
"""How harm to passengers of colliding vehicles is told: by front, sides and rear, or alike from everywhere."""
Emergency = Literal["stopping", "min_risk"]
"""What to drive when every feasible trajectory collides: what stops hardest, or what risks least for all together."""


@dataclass(frozen=True)
class PlannerConfig:
    """Everything static about one planning cycle; frozen and hashable, so it is a static argument under `jit`."""

    vehicle: Vehicle = BMW_320I
    predictor: Literal["constant_velocity", "ground_truth", "neural"] = "constant_velocity"
    horizon_steps: int = 30
    """Time steps that a trajectory looks ahead; 30 is 3.0 s."""
    shortest_end_step: int = 11
    """Earliest time step at which a sampled trajectory may reach its end speed and offset; 11 is 1.1 s."""
    sampling_level: int = 2
    """Density of the sampling matrix: 0, 1, 2, 3, 4 give 3·4·4, 5·6·6, 8·10·10, 11·18·18, 11·34·34 trajectories."""
    lateral_range: float = 3.5
    """Farthest sampled end offset from the reference path [m], to either side."""
    lowest_end_speed: float = 0.001
    """Lowest sampled end speed [m/s]."""
    highest_end_speed: float = 36.0
    """Highest sampled end speed [m/s]."""
    low_velocity_threshold: float = 2.0
    """Below this speed [m/s] the lateral polynomial runs over arc length instead of time."""
    curvature_rate_limit: float | Literal["vehicle"] = 0.4
    """Largest change of curvature [1/(m·s)], or `"vehicle"` for the limits that the kinematic single-track model has of
    its own: steering rate and friction circle, which CommonRoad's feasibility check asks for."""
    sensor_radius: float = 80.0
    """Obstacles farther than this [m] from the ego are not predicted."""
    safety_length: float = 0.5
    """Predicted obstacles are this much longer [m] than recorded ones."""
    safety_width: float = 0.2
    """Predicted obstacles are this much wider [m] than recorded ones."""
    standstill_speed: float = 0.1
    """At or below this speed [m/s] the ego stays where it is when every trajectory collides."""
    harm_model: HarmModel = "symmetric_areas"
    """How harm to passengers of colliding vehicles is told."""
    emergency: Emergency = "stopping"
    """What is driven when every feasible trajectory collides."""

    def __post_init__(self) -> None:
        """Refuse settings that no planning cycle can be built from."""
        if self.sampling_level < 0:
            raise ValueError(f"sampling_level is {self.sampling_level}: choose 0 (sparse) or more, 2 is the default")
        if not 0 < self.shortest_end_step <= self.horizon_steps:
            raise ValueError(
                f"shortest_end_step is {self.shortest_end_step}: choose one within 1 … horizon_steps = "
                f"{self.horizon_steps}"
            )
        if self.horizon_steps > LONGEST_HORIZON:
            raise ValueError(f"horizon_steps is {self.horizon_steps}: choose at most {LONGEST_HORIZON}")
        limit = self.curvature_rate_limit
        if limit != "vehicle" and not (isinstance(limit, int | float) and limit > 0):
            raise ValueError(f'curvature_rate_limit is {limit!r}: choose a number above 0 or "vehicle"')
        for name, words in (("harm_model", get_args(HarmModel)), ("emergency", get_args(Emergency))):
            if getattr(self, name) not in words:
                raise ValueError(f"{name} is {getattr(self, name)!r}: choose one of {', '.join(words)}")

    @classmethod
    def preset(cls, sampling: str, **settings: Any) -> PlannerConfig:
        """A configuration with a named sampling level, and other settings as given.

        Raises:
          ValueError: there is no such preset.
        """
        if sampling not in SAMPLING_LEVELS:
            raise ValueError(f"sampling preset is {sampling!r}: choose one of {', '.join(SAMPLING_LEVELS)}")
        return cls(sampling_level=SAMPLING_LEVELS[sampling], **settings)

    @property
    def points(self) -> int:
        """Points of a trajectory; point 0 is the current state."""
        return self.horizon_steps + 1

    @property
    def times(self) -> np.ndarray:
        """`[points]`, s, from the current state."""
        return DT * np.arange(self.points)

    @property
    def end_steps(self) -> np.ndarray:
        """`[end times]`, int: time steps at which sampled trajectories reach their end speed and offset."""
        stride = max(1, int(1.0 / (self.sampling_level + 1) / DT + 1e-9))
        return np.append(np.arange(self.shortest_end_step, self.horizon_steps, stride), self.horizon_steps)

    @property
    def samples_per_axis(self) -> int:
        """Evenly spaced end speeds, and end offsets; the current one is sampled in addition."""
        return 2 ** (self.sampling_level + 1) + 1

    @property
    def trajectories(self) -> int:
        """Trajectories in one bundle."""
        return len(self.end_steps) * (self.samples_per_axis + 1) ** 2
