"""Choice of inputs over a horizon: the predictive safety filter and the planners.

Modules are imported on use only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

try:
    from dynamics import __version__ as __version__
    from dynamics.packages import refuse_hidden
except ImportError as error:
    import dynamics

    raise ImportError(
        f"{dynamics.__file__} hides the package 'dynamics' of highway-shield: rename or move that file"
    ) from error

refuse_hidden("dynamics")

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

__getattr__, _, _ = lazy_loader.attach(
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


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
