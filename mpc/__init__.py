"""How to choose inputs over a horizon: the predictive safety filter and the planner."""

from mpc.filter import PredictiveFilter
from mpc.policy import MPCPolicy
from mpc.problem import FilterProblem, FilterSettings, Occupied, Reference, Side
from mpc.result import FilterResult, Status

__all__ = [
    "FilterProblem",
    "FilterResult",
    "FilterSettings",
    "MPCPolicy",
    "Occupied",
    "PredictiveFilter",
    "Reference",
    "Side",
    "Status",
]
