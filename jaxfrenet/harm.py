"""How badly a collision would hurt: the probability that somebody is injured at MAIS3 or worse.

Logistic regressions over the change of velocity (Geisslinger et al. 2023, "An ethical trajectory planning algorithm
for autonomous vehicles", section on harm estimation). Everything works element by element and broadcasts.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.config import HarmModel
from jaxfrenet.scenario import ObstacleKind

FIXED_MASS = {
    ObstacleKind.TRUCK: 25000.0,
    ObstacleKind.BUS: 13000.0,
    ObstacleKind.MOTORCYCLE: 250.0,
    ObstacleKind.BICYCLE: 90.0,
    ObstacleKind.PEDESTRIAN: 75.0,
    ObstacleKind.TRAIN: 118800.0,
}
"""Mass [kg] of the kinds whose mass does not depend on their size; all others weigh what a car of their size does."""
SMALLEST_MASS = 75.0
"""Mass [kg] of the smallest things: the regression for cars is negative below 3.2 m²."""
UNPROTECTED = ObstacleKind.PEDESTRIAN, ObstacleKind.BICYCLE, ObstacleKind.MOTORCYCLE
"""Kinds without a body around their passengers."""
FRONT_END, REAR_START = 0.25 * math.pi, 0.75 * math.pi
"""Impact angles [rad] at which the front ends and the rear starts; the side includes both."""
ANGLE_ROUNDING = 1e-6
"""Impact angles [rad] this near to the side's borders belong to the side."""
SIDE, REAR = 0.244, -0.431
"""What an impact on the side or rear adds to the logit of one on the front."""


@pytree_dataclass
class Party:
    """Somebody who may take part in a collision; the fields broadcast."""

    x: Float[Array, "*#shape"]
    """Centre, m."""
    y: Float[Array, "*#shape"]
    heading: Float[Array, "*#shape"]
    """rad."""
    speed: Float[Array, "*#shape"]
    """m/s, along the heading."""
    mass: Float[Array, "*#shape"]
    """kg."""


@pytree_dataclass
class Harm:
    """Probabilities of an injury of MAIS3 or worse, if there is a collision."""

    ego: Float[Array, "*shape"]
    """Of the ego's passengers."""
    third_party: Float[Array, "*shape"]
    """Of the partner's passengers, or of the partner."""


def harm(model: HarmModel, ego: Party, partner: Party, kind: Int[Array, "*#shape"]) -> Harm:
    """Harm to both sides of a collision.

    Each side's harm depends on its own change of velocity. Whoever hits an unprotected partner is judged without the
    angle of impact, the partner like a pedestrian. Structures have nothing that gives way: 1 for both.

    Args:
      model: how passengers of a vehicle that hits another are judged.
      ego: the ego.
      partner: whom it collides with.
      kind: the partner's `ObstacleKind`.
    """
    ego_change, partner_change = velocity_changes(ego, partner)
    ego_free, partner_free = _without_angle(ego_change), _without_angle(partner_change)
    if model == "symmetric_areas":
        ego_angle, partner_angle = impact_angles(ego, partner)
        ego_protected, partner_protected = _by_area(ego_change, ego_angle), _by_area(partner_change, partner_angle)
    else:
        ego_protected, partner_protected = ego_free, partner_free
    unprotected, structure = is_unprotected(kind), kind == ObstacleKind.STRUCTURE
    pedestrian = jax.nn.sigmoid(0.288 * partner_change - 3.164)
    return Harm(
        ego=jnp.where(structure, 1.0, jnp.where(unprotected, ego_free, ego_protected)),
        third_party=jnp.where(structure, 1.0, jnp.where(unprotected, pedestrian, partner_protected)),
    )


def boundary_harm(speed: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Harm to the ego that leaves the road at `speed` [m/s]."""
    return _without_angle(speed)


def obstacle_mass(
    kind: Int[Array, "*#shape"], length: Float[Array, "*#shape"], width: Float[Array, "*#shape"]
) -> Float[Array, "*shape"]:
    """Mass [kg] of obstacles by `ObstacleKind` and size [m]; a structure's has no meaning."""
    mass = jnp.maximum(526.9 * (length * width) ** 0.8 - 1333.5, SMALLEST_MASS)
    for fixed_kind, fixed_mass in FIXED_MASS.items():
        mass = jnp.where(kind == fixed_kind, fixed_mass, mass)
    return mass


def is_unprotected(kind: Int[Array, "*shape"]) -> Bool[Array, "*shape"]:
    """Whether obstacles of an `ObstacleKind` have no body around their passengers."""
    return jnp.any(jnp.stack([kind == one for one in UNPROTECTED]), axis=0)


def velocity_changes(ego: Party, partner: Party) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Changes of velocity Δv [m/s] of the ego and the partner when both go on together.

    √(v_e² + v_o² + 2 v_e v_o cos(θ_o - θ_e + π)), which is the length of the relative velocity, shared out by the
    other's part of the mass. Taken by components, it does not cancel where both drive alike.
    """
    turn = partner.heading - ego.heading
    relative = jnp.hypot(ego.speed - partner.speed * jnp.cos(turn), partner.speed * jnp.sin(turn))
    mass = ego.mass + partner.mass
    return partner.mass / mass * relative, ego.mass / mass * relative


def impact_angles(ego: Party, partner: Party) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Where each is hit, as seen from its heading [rad], in (-π, π]: 0 in front, π at the rear.

    Two at the same place see each other along the x axis.
    """
    bearing = jnp.arctan2(partner.y - ego.y, partner.x - ego.x)
    return _wrapped(bearing - ego.heading), _wrapped(jnp.pi + bearing - partner.heading)


def _wrapped(angle: Array) -> Array:
    """The angle [rad] without full turns, in (-π, π]."""
    return angle - 2 * jnp.pi * jnp.ceil((angle - jnp.pi) / (2 * jnp.pi))


def _without_angle(change: Array) -> Array:
    """Harm to passengers of a vehicle that changes its velocity by `change` [m/s], wherever it is hit."""
    return jax.nn.sigmoid(0.185 * change - 4.591)


def _by_area(change: Array, angle: Array) -> Array:
    """As `_without_angle`, with front, sides and rear told apart; left and right are alike."""
    angle = jnp.abs(angle)
    front, rear = angle < FRONT_END - ANGLE_ROUNDING, angle > REAR_START + ANGLE_ROUNDING
    return jax.nn.sigmoid(0.177 * change - 4.457 + jnp.where(front, 0.0, jnp.where(rear, REAR, SIDE)))
