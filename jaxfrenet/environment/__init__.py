"""The closed loop as a learning problem: an agent adjusts the planner's cost weights while it drives.

```
environment = DrivingEnvironment()
params = make_params(environment.config, scenarios)
observation, state = environment.reset(key, params)
observation, state, reward, terminated, truncated, info = environment.step(key, state, action, params)
```
"""

from jaxfrenet.environment.action import PAPER_ADJUSTMENTS, SAMPLING_ADJUSTMENTS, Adjustment
from jaxfrenet.environment.config import EnvironmentConfig
from jaxfrenet.environment.driving import Baseline, DrivingEnvironment, EnvironmentParams, EnvironmentState, make_params
from jaxfrenet.environment.dynamics import Situation, begin, proceed, roll_out_policy
from jaxfrenet.environment.observation import Field, observation_fields
from jaxfrenet.environment.reward import REWARD_TERMS, RewardFactors

__all__ = [
    "PAPER_ADJUSTMENTS",
    "REWARD_TERMS",
    "SAMPLING_ADJUSTMENTS",
    "Adjustment",
    "Baseline",
    "DrivingEnvironment",
    "EnvironmentConfig",
    "EnvironmentParams",
    "EnvironmentState",
    "Field",
    "RewardFactors",
    "Situation",
    "begin",
    "make_params",
    "observation_fields",
    "proceed",
    "roll_out_policy",
]
