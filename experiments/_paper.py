"""What the paper reports, to be set beside our numbers (section "Results & Analysis")."""

from __future__ import annotations

COLLISION_WEIGHTS = 0.0, 20.0, 100.0, 200.0, 400.0, 1000.0
"""Weights of the collision probability that the default planner is tried with; its own is 200."""
SCENARIOS = 547
"""Of the comparison of outcomes."""
DEFAULT_COLLISIONS, HYBRID_COLLISIONS = "some", "0"
"""In each setting of the default planner, whose number is drawn but not printed; and of the hybrid planner."""
RISK = {
    "ego": {"default": 9.11e-5, "hybrid": 3.01e-5},
    "third_party": {"default": 3.04e-5, "hybrid": 1.32e-5},
}
"""Means over 64 scenarios."""
STATISTICS = "max", "mean", "median", "std"
DRIVING = {
    ("speed", "default"): (9.784, 6.786, 6.77, 0.986),
    ("speed", "hybrid"): (8.179, 5.98, 6.132, 0.990),
    ("offset", "default"): (0.251, -0.102, -0.0188, 0.22),
    ("offset", "hybrid"): (0.726, -0.11, -0.0126, 0.224),
    ("unweighted_cost", "default"): (578.87, 17.895, 3.07, 34.07),
    ("unweighted_cost", "hybrid"): (2024.0, 20.07, 1.11, 78.72),
}
"""Largest value, mean, median and standard deviation over all steps, of the quantity and the planner; SI units."""
RUN_TIME = {"policy": 0.44, "bundle": 15.8, "step": 46.0}
"""ms, means over ten scenarios, on 16 cores with a GPU."""
TRAINING = "converges after 2 to 3 million steps; 7 million take about 24 h"
