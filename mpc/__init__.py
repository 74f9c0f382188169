"""How to choose inputs over a horizon: the predictive safety filter and the planner."""

from mpc.filter.predictive_filter import PredictiveFilter
from mpc.filter.problem import FilterProblem, FilterSettings, Occupied, Reference, Side
from mpc.filter.result import FilterResult, Status
from mpc.mpc_policy import MPCPolicy

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
