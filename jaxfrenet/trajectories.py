"""The bundle: sampled polynomials in the Frenet frame, rolled out and turned into Cartesian motion.

Everything longitudinal depends on end time and end speed only, and every lateral quantity is a straight line in the
end offset. So look-ups and polynomials are computed on rows `[end time, end speed, point]`, and a trajectory's points
are one multiply-add of its row and its end offset.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float
from jaxfrenet.config import DT, PlannerConfig
from jaxfrenet.polynomials import offset_shapes, quartic_jerk, quintic_jerk, speed_shapes
from jaxfrenet.reference_path import PathPoint, ReferencePath, look_up
from jaxfrenet.sampling import EndStates

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
class Bundle:
    """All sampled trajectories of one planning cycle, end offset innermost, end time outermost."""

    motion: EgoState
    """`[trajectories, points]`."""
    cos: Float[Array, "*batch trajectories points"]
    """`[trajectories, points]`, x of the unit vector along the heading."""
    sin: Float[Array, "*batch trajectories points"]
    relative_tangent: Float[Array, "*batch trajectories points"]
    """`[trajectories, points]`, tangent of the heading relative to the path's."""
    valid: Bool[Array, "*batch trajectories"]
    """`[trajectories]`, whether all points lie along the reference path and on this side of its centre of curvature."""
    end_step: Array
    """`[trajectories]`, int, the point at which end speed and offset are reached."""
    end_speed: Float[Array, "*batch trajectories"]
    """`[trajectories]`, m/s."""
    end_offset: Float[Array, "*batch trajectories"]
    """`[trajectories]`, m."""
    lateral_jerk: Float[Array, "*batch trajectories"]
    """`[trajectories]`, m/s^2.5, in low-velocity mode m^-1.5."""
    longitudinal_jerk: Float[Array, "*batch trajectories"]
    """`[trajectories]`, m/s^2.5."""


@pytree_dataclass
class _Longitudinal:
    """Rows `[end time, end speed, point]` of the motion along the path."""

    travelled: Array
    rate: Array
    acceleration: Array
    distance_to_end: Array
    """`[end time, end speed, 1]`, m, travelled at the end time."""


@pytree_dataclass
class _Lateral:
    """Rows of the offset and its derivatives by arc length: each is `base + gain * (end offset - offset)`."""

    base: Array
    gain: Array
    slope_base: Array
    slope_gain: Array
    bend_base: Array
    bend_gain: Array
    span: Array


def generate(config: PlannerConfig, path: ReferencePath, ego: EgoState, end: EndStates) -> Bundle:
    """Roll out all combinations of the sampled end states from the ego's state.

    Sources: Werling et al. 2010, section IV (polynomials) and appendix (Frenet to Cartesian). After its end time a
    trajectory keeps its arc length rate and offset. Below `config.low_velocity_threshold` the lateral quintic runs
    over travelled distance.
    """
    low = ego.speed < config.low_velocity_threshold
    end_time = jnp.asarray(DT * config.end_steps, jnp.float32)[:, None, None]
    inside = jnp.asarray(np.arange(config.points) <= config.end_steps[:, None])[:, None, :]
    along = _longitudinal(config, ego, end.speed, end_time)
    across = _lateral(config, ego, along, low, end_time, inside)
    arc_length = ego.arc_length + along.travelled
    frame = look_up(path, arc_length)
    moving = (along.rate > SLOW) | low
    shift = end.offset - ego.offset
    motion, cos, sin, tangent, in_frame = _to_cartesian(ego, along, across, frame, moving, shift)

    rows = along.rate.shape[:2] + shift.shape
    on_path = jnp.all((arc_length >= path.arc_length[0]) & (arc_length <= path.length), axis=-1)

    def per_trajectory(value: Array) -> Array:
        return jnp.broadcast_to(value, rows).reshape(-1)

    slope, bend = _lateral_start(ego, low)
    return Bundle(
        motion=motion,
        cos=cos,
        sin=sin,
        relative_tangent=tangent,
        valid=per_trajectory(on_path[..., None]) & in_frame,
        end_step=per_trajectory(jnp.asarray(config.end_steps, jnp.int32)[:, None, None]),
        end_speed=per_trajectory(end.speed[:, None]),
        end_offset=per_trajectory(end.offset),
        lateral_jerk=per_trajectory(quintic_jerk(across.span, slope, bend, shift)),
        longitudinal_jerk=per_trajectory(
            quartic_jerk(end_time, ego.arc_length_rate, ego.arc_length_acceleration, end.speed[:, None])
        ),
    )


def _lateral_start(ego: EgoState, low: Array) -> tuple[Array, Array]:
    """First and second derivative of the offset by the quintic's argument: time, or arc length if `low`.

    ḋ = d′ ṡ and d̈ = d″ ṡ² + d′ s̈.
    """
    rate = ego.offset_slope * ego.arc_length_rate
    acceleration = ego.offset_bend * ego.arc_length_rate**2 + ego.offset_slope * ego.arc_length_acceleration
    return jnp.where(low, ego.offset_slope, rate), jnp.where(low, ego.offset_bend, acceleration)


def _time_covered(config: PlannerConfig) -> np.ndarray:
    """`[end time, point]`, share of the time to the end time that has passed; 1 after it."""
    return np.minimum(np.arange(config.points) / config.end_steps[:, None], 1.0)


def _longitudinal(config: PlannerConfig, ego: EgoState, end_speed: Array, end_time: Array) -> _Longitudinal:
    """Quartics over time to each end speed at each end time, then constant speed."""
    shapes = jnp.asarray(np.array(speed_shapes(_time_covered(config))), jnp.float32)[:, :, :, None, :]
    start, push, stop = ego.arc_length_rate, ego.arc_length_acceleration * end_time, end_speed[:, None]
    distance, rate, acceleration = (s[0] * start + s[1] * push + s[2] * stop for s in shapes)
    after = jnp.maximum(jnp.asarray(config.times, jnp.float32) - end_time, 0.0)
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
        slope_base=slope_base.at[..., 0].set(ego.offset_slope),
        slope_gain=slope_gain.at[..., 0].set(0.0),
        bend_base=bend_base,
        bend_gain=bend_gain,
        span=span,
    )


def _hold(moving: Array, *rows: Array) -> tuple[Array, ...]:
    """Rows whose points without motion repeat the last point with motion; the first point counts as moving."""
    index = jnp.where(moving, jnp.arange(moving.shape[-1]), 0)
    last = jax.lax.cummax(index, axis=index.ndim - 1)
    return tuple(jnp.take_along_axis(row, last, axis=-1) for row in rows)


def _room(path_curvature: Array, offset: Array) -> Array:
    """1 - κ_r d, kept above zero where the trajectory is not valid anyway."""
    return jnp.maximum(1.0 - path_curvature * offset, SMALLEST_ROOM)


def _to_cartesian(
    ego: EgoState, along: _Longitudinal, across: _Lateral, frame: PathPoint, moving: Array, shift: Array
) -> tuple[EgoState, Array, Array, Array, Array]:
    """Motion, heading unit vector and relative tangent `[trajectories, points]` (Werling et al. 2010, appendix).

    The last value tells which trajectories `[trajectories]` stay where the Frenet frame is defined.

    A point that is too slow to have a direction keeps the heading of the point before.
    """
    held = _hold(moving, across.slope_base, across.slope_gain, across.base, across.gain, frame.curvature, frame.heading)
    slope_base, slope_gain, base, gain, curvature_held, heading_held = (row[:, :, None, :] for row in held)
    e = shift[:, None]
    tangent = (slope_base + slope_gain * e) / _room(curvature_held, base + gain * e)
    sec = jnp.sqrt(1.0 + tangent**2)
    cos = 1.0 / sec
    cos_held, sin_held = jnp.cos(heading_held), jnp.sin(heading_held)

    def rows(value: Array) -> Array:
        return value[:, :, None, :]

    path_cos, path_sin = rows(jnp.cos(frame.heading)), rows(jnp.sin(frame.heading))
    offset = rows(across.base) + rows(across.gain) * e
    slope = rows(across.slope_base) + rows(across.slope_gain) * e
    bend = rows(across.bend_base) + rows(across.bend_gain) * e
    rate, path_curvature = rows(along.rate), rows(frame.curvature)
    one = _room(path_curvature, offset)
    twist = rows(frame.curvature_derivative) * offset + path_curvature * slope
    curvature = (bend + twist * tangent) * cos * (cos / one) ** 2 + cos / one * path_curvature
    turning = one * tangent * (curvature * one * sec - path_curvature) - twist
    acceleration = rows(along.acceleration) * one * sec + rate**2 * sec * turning

    def flat(value: Array) -> Array:
        return jnp.broadcast_to(value, offset.shape).reshape(-1, offset.shape[-1])

    motion = EgoState(
        x=flat(rows(frame.x) - offset * path_sin),
        y=flat(rows(frame.y) + offset * path_cos),
        heading=flat(heading_held + jnp.arctan(tangent)),
        speed=flat(jnp.abs(rate * one * sec)),
        acceleration=flat(acceleration),
        curvature=flat(curvature),
        arc_length=flat(ego.arc_length + rows(along.travelled)),
        arc_length_rate=flat(rate),
        arc_length_acceleration=flat(rows(along.acceleration)),
        offset=flat(offset),
        offset_slope=flat(slope),
        offset_bend=flat(bend),
    )
    direction = cos_held * cos - sin_held * tangent * cos, sin_held * cos + cos_held * tangent * cos
    in_frame = jnp.all(1.0 - path_curvature * offset > SMALLEST_ROOM, axis=-1).reshape(-1)
    return motion, flat(direction[0]), flat(direction[1]), flat(tangent), in_frame


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
