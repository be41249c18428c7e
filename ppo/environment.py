"""What an environment has to offer."""

from __future__ import annotations

from typing import Any, Protocol

from jax import Array

Info = dict[str, Any]


class Environment(Protocol):
    """An environment with continuous actions, as pure functions.

    Instances are hashable and static under `jit`: frozen dataclasses of settings. Whatever is large or changes, a data
    set for instance, goes into `params`, any pytree, which all environments of a training run share. Functions are
    written for one environment; training maps them over many with `jax.vmap`.
    """

    @property
    def observation_size(self) -> int:
        """Elements of an observation."""
        ...

    @property
    def action_size(self) -> int:
        """Elements of an action. Actions are unbounded; the environment clips them to [-1, 1] itself."""
        ...

    def reset(self, key: Array, params: Any) -> tuple[Array, Any]:
        """Begin an episode.

        Args:
          key: a typed random key.
          params: shared by all environments.

        Returns:
          The first observation, `[observation_size]` float32, and the state, a pytree of arrays.
        """
        ...

    def step(self, key: Array, state: Any, action: Array, params: Any) -> tuple[Array, Any, Array, Array, Array, Info]:
        """Take one step; where it ends the episode, begin the next one.

        Args:
          key: a typed random key.
          state: of this environment.
          action: `[action_size]` float32.
          params: shared by all environments.

        Returns:
          observation: `[observation_size]` float32; after the end of an episode the first one of the next.
          state: likewise.
          reward: `[]` float32.
          terminated: `[]` bool, the episode ended and nothing is to be gained after it.
          truncated: `[]` bool, the episode was cut although it could have gone on.
          info: a dictionary of

            - `"last_observation"`: `[observation_size]`, what was observed after the step, before the next episode
              began; equal to `observation` where the episode goes on,
            - `"metrics"`: names and scalars, averaged over all steps for the logs,
            - `"episode"`: names and scalars that mean something at an episode's last step only, averaged over the
              episodes that ended.
        """
        ...
