"""The environment as a `gymnasium.Env`, for libraries that train with one of those."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfrenet.environment.driving import DrivingEnvironment, EnvironmentParams, EnvironmentState

try:
    import gymnasium
    from gymnasium.error import ResetNeeded
    from gymnasium.spaces import Box
except ImportError as error:
    raise ImportError("GymnasiumEnvironment needs gymnasium: pip install 'jaxfrenet[gymnasium]'") from error


class GymnasiumEnvironment(gymnasium.Env[np.ndarray, np.ndarray]):
    """One `DrivingEnvironment` behind Gymnasium's interface.

    Episodes do not follow each other by themselves: after an end, `reset` draws the next scenario.
    """

    def __init__(self, environment: DrivingEnvironment, params: EnvironmentParams) -> None:
        """Wrap an environment.

        Args:
          environment: the environment.
          params: what it draws scenarios from, as for its `reset`.
        """
        self.observation_space = Box(-np.inf, np.inf, (environment.observation_size,), np.float32)
        self.action_space = Box(-1.0, 1.0, (environment.action_size,), np.float32)
        self._reset, self._step = jax.jit(environment.reset), jax.jit(environment.step)
        self._params = params
        self._key = jax.random.key(0)
        self._state: EnvironmentState | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Draw a scenario and begin an episode in it.

        Args:
          seed: decides which scenarios this reset and those after it draw; without one the draws go on.
          options: there are none; ignored.

        Returns:
          The observation, and no information.
        """
        super().reset(seed=seed)
        self._key = jax.random.key(int(self.np_random.integers(2**32)))
        observation, self._state = self._reset(self._key, self._params)
        return np.array(observation), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drive one step.

        Args:
          action: `[actions]`, clipped to [-1, 1].

        Returns:
          Observation, reward, terminated, truncated, info. `info["metrics"]` tells of the step; where the episode has
          ended, `info["summary"]` tells of all of it (wrappers of Gymnasium keep `"episode"` for themselves).

        Raises:
          ResetNeeded: the episode has ended, or none has begun.
          ValueError: the action has another size.
        """
        if self._state is None:
            raise ResetNeeded("the episode has ended, or none has begun: call reset before step")
        adjusted = jnp.asarray(np.asarray(action, np.float32).reshape(self.action_space.shape))
        _, state, *told = self._step(self._key, self._state, adjusted, self._params)
        reward, terminated, truncated, info = jax.device_get(told)
        ended = bool(terminated or truncated)
        self._state = None if ended else state
        summary = {"summary": _plain(info["episode"])} if ended else {}
        known = {"metrics": _plain(info["metrics"]), **summary}
        return np.array(info["last_observation"]), float(reward), bool(terminated), bool(truncated), known


def _plain(scalars: dict[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in scalars.items()}
