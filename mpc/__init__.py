"""How to choose inputs over a horizon: the predictive safety filter and the planners.

Nothing is imported before it is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from mpc.cem_policy import CEMPolicy
    from mpc.filter.predictive_filter import PredictiveFilter
    from mpc.filter.problem import FilterProblem, FilterSettings, Occupied, Reference, Side
    from mpc.filter.result import FilterResult, Status
    from mpc.lookahead_policy import LookaheadPolicy
    from mpc.mpc_policy import MPCPolicy

__all__ = [
    "CEMPolicy",
    "FilterProblem",
    "FilterResult",
    "FilterSettings",
    "LookaheadPolicy",
    "MPCPolicy",
    "Occupied",
    "PredictiveFilter",
    "Reference",
    "Side",
    "Status",
]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "cem_policy": ["CEMPolicy"],
        "filter.predictive_filter": ["PredictiveFilter"],
        "filter.problem": ["FilterProblem", "FilterSettings", "Occupied", "Reference", "Side"],
        "filter.result": ["FilterResult", "Status"],
        "lookahead_policy": ["LookaheadPolicy"],
        "mpc_policy": ["MPCPolicy"],
    },
)
