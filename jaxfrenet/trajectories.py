"""The bundle: sampled polynomials in the Frenet frame, rolled out and turned into Cartesian motion.

Everything longitudinal depends on end time and end speed only, and every lateral quantity is a straight line in the
end offset. So look-ups and polynomials are computed once per row, that is per end time and end speed (`lay_out`), and
a trajectory's points are one multiply-add of its row and its end offset (`multiply_out`, `pick`).
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxfrenet._compilation import computed_once
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.config import DT, PlannerConfig
from jaxfrenet.polynomials import offset_shapes, quartic_jerk, quintic_jerk, speed_shapes
from jaxfrenet.reference_path import PathPoint, ReferencePath, look_up
from jaxfrenet.sampling import EndStates
from jaxfrenet.vehicle import Vehicle

STANDSTILL = 1e-5
"""A slower arc length rate [m/s] counts as 0; a faster one backwards is infeasible."""
SMALLEST_ROOM = 1e-3
"""A point with 1 - κ_r d below this lies at the path's centre of curvature, where the Frenet frame ends."""
SLOW = 1e-3
"""At or below this arc length rate [m/s], derivatives by arc length cannot be had from those by time."""


@pytree_dataclass
class EgoState:
    """The ego's motion at some instants, at the rear axle; all fields have one shape, `[]` or `[..., points]`.

    `offset_slope` and `offset_bend` are the first and second derivative of the offset with respect to arc length, in
    both velocity modes.
    """

    x: Float[Array, "*shape"]
    y: Float[Array, "*shape"]
    heading: Float[Array, "*shape"]
    speed: Float[Array, "*shape"]
    acceleration: Float[Array, "*shape"]
    curvature: Float[Array, "*shape"]
    arc_length: Float[Array, "*shape"]
    arc_length_rate: Float[Array, "*shape"]
    arc_length_acceleration: Float[Array, "*shape"]
    offset: Float[Array, "*shape"]
    offset_slope: Float[Array, "*shape"]
    offset_bend: Float[Array, "*shape"]


@pytree_dataclass
class Held:
    """What gives a point its heading: its own values, or the last point's that moves, if it is too slow to have one."""

    cos: Float[Array, "*shape"]
    """x of the unit vector along the reference path."""
    sin: Float[Array, "*shape"]
    curvature: Float[Array, "*shape"]
    """1/m, of the reference path."""
    base: Float[Array, "*shape"]
    gain: Float[Array, "*shape"]
    slope_base: Float[Array, "*shape"]
    slope_gain: Float[Array, "*shape"]


@pytree_dataclass
class Track:
    """What the poses at rows' points are made of; all fields have one shape.

    A lateral quantity is a line in the shift of the end offset: `base + gain * shift`.
    """

    x: Float[Array, "*shape"]
    """m, of the reference path."""
    y: Float[Array, "*shape"]
    cos: Float[Array, "*shape"]
    """x of the unit vector along it."""
    sin: Float[Array, "*shape"]
    base: Float[Array, "*shape"]
    """m, of the offset."""
    gain: Float[Array, "*shape"]
    held: Held


@pytree_dataclass
class RowPoints:
    """The points of rows, all fields `[points, rows]`."""

    track: Track
    heading: Float[Array, "*shape"]
    """rad, of the reference path, held where `Track.held` is."""
    curvature: Float[Array, "*shape"]
    """1/m, of the reference path."""
    curvature_derivative: Float[Array, "*shape"]
    arc_length: Float[Array, "*shape"]
    rate: Float[Array, "*shape"]
    """m/s, of the arc length."""
    acceleration: Float[Array, "*shape"]
    slope_base: Float[Array, "*shape"]
    """Of the offset's first derivative by arc length, a line as in `Track`."""
    slope_gain: Float[Array, "*shape"]
    bend_base: Float[Array, "*shape"]
    """1/m, of its second derivative."""
    bend_gain: Float[Array, "*shape"]


@pytree_dataclass
class Rows:
    """A whole bundle before it is multiplied out: rows, end speed outermost and end time innermost, and end offsets."""

    points: RowPoints
    shift: Float[Array, "*batch end_offsets"]
    """`[end_offsets]`, m, from the ego's offset."""
    end_offset: Float[Array, "*batch end_offsets"]
    """`[end_offsets]`, m."""
    on_path: Bool[Array, "*batch rows"]
    """`[rows]`, whether all points lie along the reference path."""
    end_step: Int[Array, "*batch rows"]
    """`[rows]`, the point at which end speed and offset are reached."""
    end_speed: Float[Array, "*batch rows"]
    """`[rows]`, m/s."""
    lateral_jerk: Float[Array, "*batch end_offsets rows"]
    """`[end_offsets, rows]`, m/s^2.5, in low-velocity mode m^-1.5."""
    longitudinal_jerk: Float[Array, "*batch rows"]
    """`[rows]`, m/s^2.5."""


@pytree_dataclass
class Pose:
    """Where the rear axle is and which way the ego points."""

    x: Float[Array, "*shape"]
    y: Float[Array, "*shape"]
    cos: Float[Array, "*shape"]
    """x of the unit vector along the heading."""
    sin: Float[Array, "*shape"]
    offset: Float[Array, "*shape"]
    """m, from the reference path."""
    relative_tangent: Float[Array, "*shape"]
    """Tangent of the heading relative to the path's."""

    def center(self, vehicle: Vehicle) -> tuple[Array, Array]:
        """X and y [m] of the vehicle's centre."""
        ahead = vehicle.rear_axle_to_center
        return self.x + ahead * self.cos, self.y + ahead * self.sin


@pytree_dataclass
class Motion:
    """How trajectories move; fields `[points, ...]`."""

    ego: EgoState
    pose: Pose
    room: Float[Array, "*shape"]
    """1 - κ_r d: 1 on the reference path, 0 at its centre of curvature."""


@pytree_dataclass
class Bundle:
    """All sampled trajectories of one planning cycle; end offset outermost, then end speed, then end time.

    The planner works on them as `[points, end offsets, rows]`: what is done at a point is a loop over trajectories
    then, of which processors take many at once. `flat` gives the shapes below.
    """

    motion: EgoState
    """`[trajectories, points]`."""
    pose: Pose
    """`[trajectories, points]`."""
    valid: Bool[Array, "*trajectories"]
    """`[trajectories]`, whether all points lie along the reference path and on this side of its centre of curvature."""
    end_step: Int[Array, "*trajectories"]
    """`[trajectories]`, the point at which end speed and offset are reached."""
    end_speed: Float[Array, "*trajectories"]
    """`[trajectories]`, m/s."""
    end_offset: Float[Array, "*trajectories"]
    """`[trajectories]`, m."""
    lateral_jerk: Float[Array, "*trajectories"]
    """`[trajectories]`, m/s^2.5, in low-velocity mode m^-1.5."""
    longitudinal_jerk: Float[Array, "*trajectories"]
    """`[trajectories]`, m/s^2.5."""

    def flat(self) -> Bundle:
        """The bundle with one axis of trajectories, and points last."""

        def turn(leaf: Array) -> Array:
            return jnp.moveaxis(leaf, 0, -1) if leaf.ndim == 3 else leaf

        return jax.tree.map(lambda leaf: (turned := turn(leaf)).reshape(-1, *turned.shape[2:]), self)


@pytree_dataclass
class _Longitudinal:
    """Motion along the path `[points, end speeds, end times]`."""

    travelled: Array
    rate: Array
    acceleration: Array
    distance_to_end: Array
    """`[end speeds, end times]`, m, travelled at the end time."""


@pytree_dataclass
class _Lateral:
    """The offset and its derivatives by arc length: each is `base + gain * (end offset - offset)`."""

    base: Array
    gain: Array
    slope_base: Array
    slope_gain: Array
    bend_base: Array
    bend_gain: Array
    span: Array
    """`[end speeds, end times]`, argument of the quintic at its end."""


def generate(config: PlannerConfig, path: ReferencePath, ego: EgoState, end: EndStates) -> Bundle:
    """All combinations of the sampled end states, rolled out from the ego's state.

    Sources: Werling et al. 2010, section IV (polynomials) and appendix (Frenet to Cartesian). After its end time a
    trajectory keeps its arc length rate and offset. Below `config.low_velocity_threshold` the lateral quintic runs
    over travelled distance.
    """
    return multiply_out(lay_out(config, path, ego, end)).flat()


@partial(computed_once, static_argnums=(0,))
def lay_out(config: PlannerConfig, path: ReferencePath, ego: EgoState, end: EndStates) -> Rows:
    """The rows of the bundle that `generate` makes of the same arguments."""
    low = ego.speed < config.low_velocity_threshold
    end_time = jnp.asarray(DT * config.end_steps, jnp.float32)
    inside = jnp.asarray(np.arange(config.points)[:, None] <= config.end_steps)[:, None, :]
    end_speed = end.speed[:, None]
    along = _longitudinal(config, ego, end_speed, end_time)
    across = _lateral(config, ego, along, low, end_time, inside)
    arc_length = ego.arc_length + along.travelled
    on_path = jnp.all((arc_length >= path.arc_length[0]) & (arc_length <= path.length), axis=0)
    shift = end.offset - ego.offset
    start = _lateral_start(ego, low)
    longitudinal_jerk = quartic_jerk(end_time, ego.arc_length_rate, ego.arc_length_acceleration, end_speed)
    end_step = jnp.asarray(config.end_steps, jnp.int32)
    frame = look_up(path, arc_length)
    moving = (along.rate > SLOW) | low
    points = _row_points(arc_length, along, across, frame, moving)

    def per_row(value: Array) -> Array:
        return jnp.broadcast_to(value, on_path.shape).reshape(-1)

    return Rows(
        points=jax.tree.map(lambda leaf: leaf.reshape(config.points, -1), points),
        shift=shift,
        end_offset=end.offset,
        on_path=per_row(on_path),
        end_step=per_row(end_step),
        end_speed=per_row(end_speed),
        lateral_jerk=quintic_jerk(across.span, *start, shift[:, None, None]).reshape(len(end.offset), -1),
        longitudinal_jerk=per_row(longitudinal_jerk),
    )


def multiply_out(rows: Rows) -> Bundle:
    """All trajectories of the rows; they have the two axes `[end offsets, rows]`."""
    motion = _move(jax.tree.map(lambda leaf: leaf[:, None, :], rows.points), rows.shift[:, None])
    in_frame = jnp.all(motion.room > SMALLEST_ROOM, axis=0)
    return Bundle(
        motion=motion.ego,
        pose=motion.pose,
        valid=rows.on_path & in_frame,
        end_step=jnp.broadcast_to(rows.end_step, in_frame.shape),
        end_speed=jnp.broadcast_to(rows.end_speed, in_frame.shape),
        end_offset=jnp.broadcast_to(rows.end_offset[:, None], in_frame.shape),
        lateral_jerk=rows.lateral_jerk,
        longitudinal_jerk=jnp.broadcast_to(rows.longitudinal_jerk, in_frame.shape),
    )


def pick(rows: Rows, index: Int[Array, "*some"]) -> Motion:
    """The trajectories of a bundle with these places in it, fields `[*some, points]`."""
    offset, row = jnp.divmod(index, rows.on_path.shape[-1])
    points = jax.tree.map(lambda leaf: jnp.moveaxis(leaf[:, row], 0, -1), rows.points)
    return _move(points, rows.shift[offset][..., None])


def _lateral_start(ego: EgoState, low: Array) -> tuple[Array, Array]:
    """First and second derivative of the offset by the quintic's argument: time, or arc length if `low`.

    ḋ = d′ ṡ and d̈ = d″ ṡ² + d′ s̈.
    """
    rate = ego.offset_slope * ego.arc_length_rate
    acceleration = ego.offset_bend * ego.arc_length_rate**2 + ego.offset_slope * ego.arc_length_acceleration
    return jnp.where(low, ego.offset_slope, rate), jnp.where(low, ego.offset_bend, acceleration)


def _time_covered(config: PlannerConfig) -> np.ndarray:
    """`[points, end times]`, share of the time to the end time that has passed; 1 after it."""
    return np.minimum(np.arange(config.points)[:, None] / config.end_steps, 1.0)


def _longitudinal(config: PlannerConfig, ego: EgoState, end_speed: Array, end_time: Array) -> _Longitudinal:
    """Quartics over time to each end speed at each end time, then constant speed."""
    shapes = jnp.asarray(np.array(speed_shapes(_time_covered(config))), jnp.float32)[:, :, :, None, :]
    start, push, stop = ego.arc_length_rate, ego.arc_length_acceleration * end_time, end_speed
    distance, rate, acceleration = (s[0] * start + s[1] * push + s[2] * stop for s in shapes)
    after = jnp.maximum(jnp.asarray(config.times, jnp.float32)[:, None, None] - end_time, 0.0)
    to_end = end_time * (0.5 * start + end_time * ego.arc_length_acceleration / 12 + 0.5 * stop)
    return _Longitudinal(
        travelled=end_time * distance + stop * after,
        rate=jnp.where(jnp.abs(rate) < STANDSTILL, 0.0, rate),
        acceleration=acceleration / end_time,
        distance_to_end=to_end,
    )


def _lateral(
    config: PlannerConfig, ego: EgoState, along: _Longitudinal, low: Array, end_time: Array, inside: Array
) -> _Lateral:
    """Quintics over time, or over travelled distance in low-velocity mode, as derivatives by arc length."""
    tau = jnp.asarray(_time_covered(config), jnp.float32)[:, None, :]
    span = jnp.where(low & (along.distance_to_end > 0), along.distance_to_end, end_time)
    covered = jnp.where(inside, along.travelled, along.distance_to_end) / span
    value, first, second = offset_shapes(jnp.where(low, covered, tau))
    slope, bend = _lateral_start(ego, low)
    slope, bend = slope * span, bend * span**2

    rate, acceleration = along.rate, along.acceleration
    moving = rate > SLOW
    per_rate = jnp.where(low, 1.0, jnp.where(moving, 1.0 / jnp.where(moving, rate, 1.0), 0.0))
    per_rate = jnp.where(inside, per_rate, 0.0)
    drag = jnp.where(low, 0.0, acceleration)

    slope_base, slope_gain = ((slope * first[0] + bend * first[1]) / span * per_rate, first[2] / span * per_rate)
    bend_base = ((slope * second[0] + bend * second[1]) / span**2 - slope_base * drag) * per_rate**2
    bend_gain = (second[2] / span**2 - slope_gain * drag) * per_rate**2
    return _Lateral(
        base=ego.offset + slope * value[0] + bend * value[1],
        gain=value[2],
        slope_base=slope_base.at[0].set(ego.offset_slope),
        slope_gain=slope_gain.at[0].set(0.0),
        bend_base=bend_base,
        bend_gain=bend_gain,
        span=span,
    )


def _row_points(
    arc_length: Array, along: _Longitudinal, across: _Lateral, frame: PathPoint, moving: Array
) -> RowPoints:
    """Points `[points, end speeds, end times]`."""
    lines = across.base, across.gain, across.slope_base, across.slope_gain
    every = frame.heading, frame.curvature, *lines, across.bend_base, across.bend_gain
    heading, curvature, base, gain, slope_base, slope_gain, bend_base, bend_gain = jnp.broadcast_arrays(*every)
    held_heading, *held = _hold(moving, jnp.stack([heading, curvature, base, gain, slope_base, slope_gain], axis=-1))
    return RowPoints(
        track=Track(
            x=frame.x,
            y=frame.y,
            cos=jnp.cos(heading),
            sin=jnp.sin(heading),
            base=base,
            gain=gain,
            held=Held(jnp.cos(held_heading), jnp.sin(held_heading), *held),
        ),
        heading=held_heading,
        curvature=curvature,
        curvature_derivative=frame.curvature_derivative,
        arc_length=arc_length,
        rate=along.rate,
        acceleration=along.acceleration,
        slope_base=slope_base,
        slope_gain=slope_gain,
        bend_base=bend_base,
        bend_gain=bend_gain,
    )


def _hold(moving: Array, values: Array) -> list[Array]:
    """Values `[points, ..., values]`, those of points without motion replaced by the last ones with; one array each.

    The first point counts as moving.
    """
    last = jax.lax.cummax(jnp.where(moving, jnp.arange(len(moving)).reshape(-1, *(1,) * (moving.ndim - 1)), 0), axis=0)
    held = jnp.take_along_axis(values, last[..., None], axis=0)
    return [held[..., i] for i in range(values.shape[-1])]


def _room(path_curvature: Array, offset: Array) -> Array:
    """1 - κ_r d, kept above zero where the trajectory is not valid anyway."""
    return jnp.maximum(1.0 - path_curvature * offset, SMALLEST_ROOM)


def place(track: Track, shift: Array) -> Pose:
    """Poses on a track, the end offset shifted by `shift` [m]; the two broadcast (Werling et al. 2010, appendix)."""
    held = track.held
    tangent = (held.slope_base + held.slope_gain * shift) / _room(held.curvature, held.base + held.gain * shift)
    cos = 1.0 / jnp.sqrt(1.0 + tangent**2)
    offset = track.base + track.gain * shift
    return Pose(
        x=track.x - offset * track.sin,
        y=track.y + offset * track.cos,
        cos=cos * (held.cos - held.sin * tangent),
        sin=cos * (held.sin + held.cos * tangent),
        offset=offset,
        relative_tangent=tangent,
    )


def _move(points: RowPoints, shift: Array) -> Motion:
    """Motion at rows' points, the end offset shifted; the two broadcast (Werling et al. 2010, appendix)."""
    pose = place(points.track, shift)
    offset, tangent = pose.offset, pose.relative_tangent
    sec = jnp.sqrt(1.0 + tangent**2)
    cos = 1.0 / sec
    slope = points.slope_base + points.slope_gain * shift
    bend = points.bend_base + points.bend_gain * shift
    rate, path_curvature = points.rate, points.curvature
    one = _room(path_curvature, offset)
    twist = points.curvature_derivative * offset + path_curvature * slope
    curvature = (bend + twist * tangent) * cos * (cos / one) ** 2 + cos / one * path_curvature
    turning = one * tangent * (curvature * one * sec - path_curvature) - twist
    arc_length, rate, along = (
        jnp.broadcast_to(row, offset.shape) for row in (points.arc_length, rate, points.acceleration)
    )
    ego = EgoState(
        x=pose.x,
        y=pose.y,
        heading=points.heading + jnp.arctan(tangent),
        speed=jnp.abs(rate * one * sec),
        acceleration=along * one * sec + rate**2 * sec * turning,
        curvature=curvature,
        arc_length=arc_length,
        arc_length_rate=rate,
        arc_length_acceleration=along,
        offset=offset,
        offset_slope=slope,
        offset_bend=bend,
    )
    return Motion(ego, pose, room=1.0 - path_curvature * offset)


def initial_ego_state(
    path: ReferencePath,
    *,
    arc_length: Float[Array, ""],
    offset: Float[Array, ""],
    x: Float[Array, ""],
    y: Float[Array, ""],
    heading: Float[Array, ""],
    speed: Float[Array, ""],
    acceleration: Float[Array, ""],
    curvature: Float[Array, ""],
) -> EgoState:
    """The full state of an ego given in Cartesian terms and projected to `arc_length`, `offset` on the path.

    The inverse of the Frenet to Cartesian transformation (Werling et al. 2010, appendix). `heading` must be within
    90° of the path's and on the same turn.
    """
    frame = look_up(path, arc_length)
    relative = heading - frame.heading
    cos, tan = jnp.cos(relative), jnp.tan(relative)
    one = 1.0 - frame.curvature * offset
    slope = one * tan
    twist = frame.curvature_derivative * offset + frame.curvature * slope
    excess = curvature * one / cos - frame.curvature
    rate = speed * cos / one
    turning = rate**2 / cos * (one * tan * excess - twist)
    return EgoState(
        x=x,
        y=y,
        heading=heading,
        speed=speed,
        acceleration=acceleration,
        curvature=curvature,
        arc_length=arc_length,
        arc_length_rate=rate,
        arc_length_acceleration=(acceleration - turning) * cos / one,
        offset=offset,
        offset_slope=slope,
        offset_bend=-twist * tan + one / cos**2 * excess,
    )
