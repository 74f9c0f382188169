"""`LatentShield`: a filter of actions by a learned monitor, where no simulator's state exists.

It reads observations only, and gives no guarantee: nothing is verified. `docs/learned-monitor.md` has its
measured crash rates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from dynamics.state import FloatArray, IntArray
from shield.errors import ConfigError, PolicyError
from shield.wrappers.ranking import ranking_of

__all__ = ["LatentDecision", "LatentShield", "UnsafetyModel", "filtered_actions"]


class UnsafetyModel(Protocol):
    """A model of how unsafe each action is, for example `dynamics.world_model.monitor.SafetyMonitor`."""

    def probabilities(self, frames: Any, /) -> FloatArray:
        """Probability that no verified continuation exists after each action, (n, actions), from n observations."""


@dataclass(frozen=True, slots=True)
class LatentDecision:
    """Decision about one action.

    Attributes
    ----------
    proposed, executed : action indices.
    risk_proposed, risk_executed : probability that no verified continuation exists after them.
    fallback : whether no action was below the threshold; the least risky one was executed.
    """

    proposed: int
    executed: int
    risk_proposed: float
    risk_executed: float
    fallback: bool

    @property
    def overridden(self) -> bool:
        """Whether another action than the proposed one was executed."""
        return self.executed != self.proposed


def filtered_actions(risks: FloatArray, proposed: IntArray, preferences: Any, threshold: float) -> IntArray:
    """Actions to execute, (n,): the proposal if its risk is at most the threshold; otherwise the preferred action with
    such a risk, or the least risky one if there is none.

    Parameters
    ----------
    risks : (n, actions); NaN counts as 1. proposed : (n,).
    preferences : scores of the actions, (n, actions), higher is preferred; None prefers the least risky.
    threshold : greatest accepted risk.
    """
    known = np.nan_to_num(risks, nan=1.0)
    each = np.arange(len(known))
    accepted = known <= threshold
    scores = -known if preferences is None else np.nan_to_num(np.asarray(preferences, float), nan=-np.inf)
    best = np.where(accepted, scores, -np.inf).argmax(axis=1)
    # A preference of -inf for each accepted action would make `argmax` choose a refused one.
    best = np.where(accepted[each, best], best, known.argmin(axis=1))
    alternative = np.where(accepted.any(axis=1), best, known.argmin(axis=1))
    chosen: IntArray = np.where(accepted[each, proposed], proposed, alternative)
    return chosen


class LatentShield:
    """Wraps a policy with discrete actions; `predict` returns its action where the monitor accepts it.

    Parameters
    ----------
    policy : an SB3 model, or any object with its `predict`.
    model : the monitor.
    threshold : greatest accepted risk, between 0 and 1; by default the calibrated one, `model.config.threshold`.
    observe : function from the policy's observations to those of the monitor; by default they are the same.

    Raises
    ------
    ConfigError
        If there is no threshold, or it is not between 0 and 1.

    Attributes
    ----------
    decisions : the `LatentDecision` of each environment since the last `predict`.

    Notes
    -----
    Where the policy has preferences (`shield.wrappers.ranking.ranking_of`), the preferred accepted action replaces a
    refused one. Where it has none, the least risky one does.
    """

    def __init__(self, policy: Any, model: UnsafetyModel, threshold: float | None = None, observe: Any = None) -> None:
        found = getattr(getattr(model, "config", None), "threshold", None) if threshold is None else threshold
        if found is None or not 0 < found < 1:
            raise ConfigError(f"the threshold of a LatentShield is between 0 and 1, not {found!r}")
        self.policy, self.model, self.threshold, self._observe = policy, model, float(found), observe
        self.decisions: list[LatentDecision] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """SB3's `predict`, with the actions filtered; one observation, or a batch.

        Raises
        ------
        PolicyError
            If an action of the policy is not one of the actions that the monitor knows.
        """
        actions, state = self.policy.predict(
            observation, state=state, episode_start=episode_start, deterministic=deterministic
        )
        single = np.ndim(actions) == 0
        batch = np.asarray(observation)[None] if single else observation
        risks = self.model.probabilities(batch if self._observe is None else self._observe(batch))
        proposed = np.atleast_1d(np.asarray(actions))
        if proposed.shape != (len(risks),) or not np.isin(proposed, np.arange(risks.shape[1])).all():
            raise PolicyError(
                f"LatentShield filters one action from 0 to {risks.shape[1] - 1} for each of {len(risks)} "
                f"observations; the policy returned {actions!r}"
            )
        proposed = proposed.astype(np.intp)
        executed = filtered_actions(risks, proposed, ranking_of(self.policy, batch), self.threshold)
        # Where any action is accepted, the executed one is.
        self.decisions = [
            LatentDecision(int(p), int(e), float(row[p]), float(row[e]), not bool(row[e] <= self.threshold))
            for p, e, row in zip(proposed, executed, risks, strict=True)
        ]
        return (executed[0] if single else executed), state
