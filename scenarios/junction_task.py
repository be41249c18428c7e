"""What drives through a junction are drawn from: settings that all junction families share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jaxfrenet as jf
from scenarios.assembly import path_capacity
from scenarios.distributions import Knots, check_knots, check_number
from scenarios.errors import ScenarioError
from scenarios.vehicle_types import VehicleType

Role = Literal["own", "exit", "other", "fourth"]
"""An arm as the ego sees it: the one it comes from, the one it leaves by, and the rest counter-clockwise."""
ROLES: tuple[Role, ...] = ("own", "exit", "other", "fourth")
MAX_VEHICLES = 8
"""Most vehicles in one scenario."""
MAX_PEDESTRIANS = 4
LONGEST_CURVE = 60.0
"""No lane through a junction is longer than this [m]."""
NEAREST_START = 3.0
"""No ego starts nearer to the junction than this [m]."""


@dataclass(frozen=True)
class Stream:
    """Vehicles that come one after the other from one arm."""

    origin: Role
    """The arm they come from."""
    destination: Role | Literal["any"] = "any"
    """The arm they leave by."""
    vehicles: int = 1
    """Most of them."""
    arrival: Knots | Literal["behind the ego"] = (-5.0, 5.0)
    """How much later than the ego the first one would arrive in the middle of the junction [s], both at constant speed;
    or it follows the ego."""
    speed: Knots = (5.0, 10.0)
    """Of the first one [m/s]; relative to the ego's if it follows the ego."""
    distance: Knots | None = None
    """From the first one's start to the middle of the junction [m]: then its arrival says how fast it is."""
    spacing: Knots = (10.0, 30.0)
    """Distance between the centres of one and the next [m]."""
    follower_speed: Knots = (0.8, 1.1)
    """Of each further one, relative to the one ahead."""
    goes_first: bool = False
    """Whether none of them ever lets others go first."""
    followers_arrive: bool = True
    """Whether the further ones may come to the middle of the junction before the record ends; if not, they are slow."""


@dataclass(frozen=True, kw_only=True)
class JunctionTask:
    """What all junction families have in common; numbers are drawn from distributions, see `Knots`."""

    steps: int = 148
    """Recorded time steps of 0.1 s."""
    lane_width: Knots = (3.2, 4.0)
    """m."""
    turn_radius: Knots = (7.0, 10.5)
    """Of the tightest road curve's middle [m]; never more than three lane widths."""
    bend: Knots = (-0.3, 0.3)
    """Angle by which each arm bends [rad]."""
    own_arm: Knots = (60.0, 110.0)
    """Length of the arm that the ego comes from [m], at least so that it starts on it."""
    exit_arm: Knots = (50.0, 110.0)
    """Length of the arm that it leaves by [m]."""
    other_arms: Knots = (60.0, 110.0)
    """Length of the others [m]."""
    start_distance: Knots = (8.0, 45.0)
    """From the ego's start to where it enters the junction [m]."""
    start_time: Knots | None = None
    """When the ego would be in the middle of the junction at its start speed [s], in place of that distance."""
    start_speed: Knots = (2.0, 8.0)
    """m/s."""
    start_offset: Knots = (-0.15, 0.15)
    """Of the ego's start from the middle of its lane [m]."""
    goal_in_junction: float | Literal["at start speed"] = 0.25
    """Probability that the goal is the junction itself instead of the arm behind it; or it is the one of the two where
    the ego would be in time at its start speed."""
    pace: Knots = (4.5, 8.0)
    """Mean speed [m/s] from the start to the middle of the goal's region, which decides when to be there."""
    goal_steps: tuple[int, int] | None = None
    """First and last step of the goal, in place of what the pace says."""
    goal_window: int = 5
    """How many steps before and after that time the goal can be reached."""
    streams: tuple[Stream, ...] = ()
    """The traffic."""
    vehicle_types: tuple[VehicleType, ...] = ()
    """What drives there."""
    separation: float = 0.0
    """Least time between the arrivals of two streams' first vehicles [s]; the one of the later stream moves."""
    density: float = 0.5
    """Difficulty: probability that a vehicle of a stream is there."""
    gap: float = 1.0
    """Difficulty: factor on arrivals and spacings; the smaller, the tighter the gaps in oncoming traffic."""
    speed_spread: float = 0.1
    """Difficulty: standard deviation of the logarithm of a further factor on each vehicle's speed."""
    yielding: float = 0.7
    """Share of vehicles that let others go first where lanes meet."""
    slow_in_curves: bool = True
    """Whether vehicles slow down for curves."""
    pedestrians: int = 0
    """Most pedestrians, each of whom crosses one of the arms."""
    pedestrian_arrival: Knots = (-4.0, 4.0)
    """How much later than the ego would be in the middle of the junction they are in the middle of the road [s]."""
    walking_speed: Knots = (0.8, 1.8)
    """m/s."""

    def __post_init__(self) -> None:
        """Refuse what no scenario can be made of.

        Raises:
          ScenarioError: a value is impossible.
        """
        for name, low, high in (
            ("lane_width", 2.5, 6.0),
            ("turn_radius", 5.5, 30.0),
            ("bend", -0.6, 0.6),
            ("own_arm", 40.0, 300.0),
            ("exit_arm", 30.0, 300.0),
            ("other_arms", 40.0, 300.0),
            ("start_distance", NEAREST_START, 200.0),
            ("start_speed", 0.0, 20.0),
            ("start_offset", -0.5, 0.5),
            ("pace", 1.0, 20.0),
            ("pedestrian_arrival", -60.0, 60.0),
            ("walking_speed", 0.1, 5.0),
        ):
            check_knots(name, getattr(self, name), low, high)
        for name, low, high in (
            ("separation", 0.0, 20.0),
            ("density", 0.0, 1.0),
            ("gap", 0.1, 10.0),
            ("speed_spread", 0.0, 0.5),
            ("yielding", 0.0, 1.0),
            ("steps", 60, 1000),
            ("goal_window", 0, 50),
            ("pedestrians", 0, MAX_PEDESTRIANS),
        ):
            check_number(name, getattr(self, name), low, high)
        if self.start_time is not None:
            check_knots("start_time", self.start_time, 0.5, 60.0)
        if self.goal_in_junction != "at start speed":
            check_number("goal_in_junction", self.goal_in_junction, 0.0, 1.0)
        elif self.goal_steps is None:
            raise ScenarioError("goal_in_junction is 'at start speed' but goal_steps is None: give both")
        if self.goal_steps is not None and not 0 < self.goal_steps[0] <= self.goal_steps[1] < self.steps:
            raise ScenarioError(f"goal_steps is {self.goal_steps}: give two steps within 1 … {self.steps - 1}")
        if (count := sum(stream.vehicles for stream in self.streams)) > MAX_VEHICLES:
            raise ScenarioError(f"streams hold {count} vehicles: give at most {MAX_VEHICLES} altogether")
        if not self.streams or not self.vehicle_types:
            empty = "vehicle_types" if self.streams else "streams"
            raise ScenarioError(f"{empty} is empty: name at least one, and density=0.0 for an empty road")
        for stream in self.streams:
            _check_stream(stream)

    @property
    def farthest_start(self) -> float:
        """Largest distance from the ego's start to the junction [m]."""
        if self.start_time is None:
            return self.start_distance[-1]
        return max(self.start_time[-1] * self.start_speed[-1], NEAREST_START)

    @property
    def path_nodes(self) -> int:
        """Nodes that are enough for every path."""
        goal = LONGEST_CURVE + self.exit_arm[-1]
        first = self.goal_steps[1] if self.goal_steps is not None else self.steps - 2 - self.goal_window
        pace = 0.0 if self.goal_steps is not None else 2.0 * self.pace[-1]
        speed = max(self.start_speed[-1], (self.farthest_start + goal) / (jf.DT * first), pace)
        return path_capacity(self.farthest_start, goal, speed)


def _check_stream(stream: Stream) -> None:
    name = f"stream from {stream.origin}"
    if stream.origin not in ROLES or stream.destination not in (*ROLES, "any") or stream.origin == stream.destination:
        raise ScenarioError(f"{name} to {stream.destination}: give two different ones of {', '.join(ROLES)}")
    if stream.vehicles < 1:
        raise ScenarioError(f"{name} has {stream.vehicles} vehicles: give at least 1")
    if stream.arrival != "behind the ego":
        check_knots(f"{name}: arrival", stream.arrival, -60.0, 60.0)
    check_knots(f"{name}: speed", stream.speed, 0.0, 40.0)
    if stream.distance is not None:
        check_knots(f"{name}: distance", stream.distance, 5.0, 300.0)
    check_knots(f"{name}: spacing", stream.spacing, 4.0, 200.0)
    check_knots(f"{name}: follower_speed", stream.follower_speed, 0.0, 3.0)
