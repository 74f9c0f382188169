"""Names and numbers that the command line shows before anything that is slow to import is needed."""

from __future__ import annotations

__all__ = ["BASELINES", "CHANNEL_NAMES", "FIRST_EVALUATION_SEED", "MODELS", "SENSOR_NAMES", "SIMULATORS", "TRAINABLE"]

FIRST_EVALUATION_SEED = 10_000
"""Seeds below it are for training and choosing, from it on for evaluation."""
TRAINABLE = ("a2c", "dqn", "ppo", "sac", "td3", "trpo")
"""The algorithms that `shield train` knows."""
SIMULATORS = ("auto", "compiled", "highway-env")
"""What episodes are driven in: highway-env's own code, its compiled copy, or that one where it serves."""
SENSOR_NAMES = (
    *("exact", "metric-0.5", "metric-2", "metric-2-late", "normalised-0.2", "normalised-0.5"),
    *("heavy-0.5", "biased-0.5", "worsening-0.5", "ghosts", "range-60"),
)
"""The sensors in `evaluation.wrappers.SENSORS`."""
CHANNEL_NAMES = ("confidence", "tracked-confidence", "intent")
"""What can be added to what they show, `evaluation.wrappers.channels.CHANNELS`."""
MODELS = ("bicycle", "learned")
"""What the predictive filter can plan with; a folder of models is the third."""
BASELINES = (
    "faster",
    "idle",
    "slower",
    "throttle",
    "random",
    "weaving",
    "left",
    "right",
    "lookahead",
    "lookahead-shielded",
    "mpc",
    "cem",
    "cem-fast",
    "cem-oracle",
    "cem-notebook",
    "cem-mppi",
    "cem-cautious",
)
"""Policies that need no training: `faster` and `slower` for meta-actions, `throttle` (full throttle, the wheel
straight) for continuous actions, `idle` and `random` for both; `left` and `right` change lanes
wherever they can, `weaving` to and fro; `lookahead` knows
the future (`mpc.lookahead_policy`, on the simulator's true state), and `lookahead-shielded` that behind the shield
(`shield.batch.lookahead`); `mpc` drives with continuous actions by itself
(`mpc.MPCPolicy`, on the simulator's true state); the others park (`evaluation.running.parking_planner`), and `cem`
drives on a highway and in a roundabout with meta-actions as well."""
