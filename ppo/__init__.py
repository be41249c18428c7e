"""Recurrent proximal policy optimization over any environment that is written in JAX.

A whole training run is one pure function, for tests and sweeps:

```
run = jax.jit(ppo.train, static_argnums=(0, 1, 5))
state, metrics = run(ppo.PPOConfig(), environment, ppo.Hyperparameters(), params, jax.random.key(0), 100)
policy = ppo.current_policy(ppo.PPOConfig(), state)
```

`ppo.train_chunk` is a part of one, for runs that are watched, validated and resumed: call it again and again with the
state it returns, and keep that with `ppo.Checkpoints`. `jax.vmap` over keys and hyperparameters trains several at once;
with `mesh=ppo.environment_mesh()` several devices share the environments.
"""

from ppo.checkpoints import CheckpointError, Checkpoints
from ppo.config import Hyperparameters, NetworkConfig, PPOConfig
from ppo.diagnosis import NONFINITE_NAMES, first_nonfinite
from ppo.environment import Environment, Info
from ppo.evaluation import Evaluation, evaluate
from ppo.policy import Policy, PolicyError, act, average_policies, initial_carry, load_policy, save_policy, value
from ppo.sharding import environment_mesh, replicate
from ppo.training import TrainingState, current_policy, initial_state, state_shardings, train, train_chunk, train_update

__all__ = [
    "NONFINITE_NAMES",
    "CheckpointError",
    "Checkpoints",
    "Environment",
    "Evaluation",
    "Hyperparameters",
    "Info",
    "NetworkConfig",
    "PPOConfig",
    "Policy",
    "PolicyError",
    "TrainingState",
    "act",
    "average_policies",
    "current_policy",
    "environment_mesh",
    "evaluate",
    "first_nonfinite",
    "initial_carry",
    "initial_state",
    "load_policy",
    "replicate",
    "save_policy",
    "state_shardings",
    "train",
    "train_chunk",
    "train_update",
    "value",
]
