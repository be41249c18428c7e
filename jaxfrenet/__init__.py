"""A sampling-based motion planner in the Frenet frame, as pure functions on JAX arrays.

```
import jaxfrenet as jf

config = jf.PlannerConfig()
state = jf.reset(config, scenario)
cycle = jf.plan(config, scenario, state, jf.CostWeights())
state, report = jf.step(config, scenario, state, jf.CostWeights())
```
"""

from jaxfrenet.config import DT, PlannerConfig
from jaxfrenet.costs import COST_TERMS, CostInputs, CostWeights, ExtraTerm
from jaxfrenet.planner import PlanMode, PlanningCycle, plan
from jaxfrenet.prediction import Prediction, predict, with_predictions
from jaxfrenet.reference_path import ReferencePath
from jaxfrenet.risk import Risk, assess, assess_bundle
from jaxfrenet.sampling import SAMPLING_TERMS, SamplingRange
from jaxfrenet.scenario import (
    Goal,
    InitialState,
    LaneMap,
    Lanes,
    ObstacleKind,
    Obstacles,
    PredictionTable,
    Road,
    Scenario,
)
from jaxfrenet.simulation import Episode, StepReport, advance, max_steps, reset, roll_out, step
from jaxfrenet.state import Outcome, SimulationState
from jaxfrenet.trajectories import Bundle, EgoState
from jaxfrenet.vehicle import BMW_320I, FORD_ESCORT, VW_VANAGON, Vehicle

__all__ = [
    "BMW_320I",
    "COST_TERMS",
    "DT",
    "FORD_ESCORT",
    "SAMPLING_TERMS",
    "VW_VANAGON",
    "Bundle",
    "CostInputs",
    "CostWeights",
    "EgoState",
    "Episode",
    "ExtraTerm",
    "Goal",
    "InitialState",
    "LaneMap",
    "Lanes",
    "ObstacleKind",
    "Obstacles",
    "Outcome",
    "PlanMode",
    "PlannerConfig",
    "PlanningCycle",
    "Prediction",
    "PredictionTable",
    "ReferencePath",
    "Risk",
    "Road",
    "SamplingRange",
    "Scenario",
    "SimulationState",
    "StepReport",
    "Vehicle",
    "advance",
    "assess",
    "assess_bundle",
    "max_steps",
    "plan",
    "predict",
    "reset",
    "roll_out",
    "step",
    "with_predictions",
]
