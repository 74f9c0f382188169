"""Preferences of a policy: scores of discrete actions, and the order that follows from them."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.state import FloatArray, IntArray

__all__ = ["Ranking", "normalised", "order_from_scores", "orders_from_scores", "ranking_of"]


def ranking_of(policy: Any, obs: Any) -> Any:
    """Preference scores of discrete actions for a batch of observations, (n, actions), or None.

    The scores are Q-values for value-based models and action probabilities for stochastic ones; higher is preferred.
    `policy` is an SB3 or sb3-contrib model, a bare policy, or any object; its method `action_scores(obs)` takes
    precedence. None for recurrent policies: their scores depend on more than the observation.
    """
    import torch

    if hasattr(policy, "action_scores"):
        scores = policy.action_scores(obs)
        return None if scores is None else np.asarray(scores, dtype=float)
    net = getattr(policy, "policy", policy)
    if not hasattr(net, "obs_to_tensor") or hasattr(net, "lstm_actor"):
        return None
    with torch.no_grad():
        tensor, _ = net.obs_to_tensor(obs)
        if hasattr(net, "q_net"):
            return net.q_net(tensor).cpu().numpy().astype(float)
        if hasattr(net, "quantile_net"):
            return net.quantile_net(tensor).mean(dim=1).cpu().numpy().astype(float)
        if hasattr(net, "get_distribution"):
            distribution = getattr(net.get_distribution(tensor), "distribution", None)
            probs = getattr(distribution, "probs", None)
            return None if probs is None else probs.cpu().numpy().astype(float)
    return None


def normalised(policy: Any, observation: Any) -> Any:
    """The observation as the model expects it: normalised by its `VecNormalize`, if it has one."""
    inside = getattr(policy, "get_vec_normalize_env", lambda: None)()
    return observation if inside is None else inside.normalize_obs(observation)


def _ranked(scores: Any) -> IntArray:
    """Action indices in descending order of score along the last axis; NaN scores come last."""
    return np.argsort(-np.nan_to_num(np.asarray(scores, dtype=float), nan=-np.inf), axis=-1, kind="stable")


def order_from_scores(scores: Any, proposed: int) -> list[int]:
    """Action indices in descending order of score, without the proposal; NaN scores come last."""
    return [int(a) for a in _ranked(scores) if a != proposed]


def orders_from_scores(scores: FloatArray, proposed: IntArray) -> IntArray:
    """`order_from_scores` of many, scores (n, k) and proposals (n,), each terminated by -1: (n, k)."""
    ranked = _ranked(scores)
    n, k = ranked.shape
    others = ranked[ranked != proposed[:, None]].reshape(n, k - 1)
    return np.concatenate([others, np.full((n, 1), -1)], axis=1)


class Ranking:
    """The policy's order of preference for one batch of observations, computed at most once."""

    def __init__(self, policy: Any, observation: Any) -> None:
        self._policy, self._observation = policy, observation
        self._scores: Any = None

    def order(self, row: int, proposed: int, actions: int) -> list[int] | None:
        """Order of the other actions, for one row of the batch; None if the policy has no scores for that number of
        actions.

        Parameters
        ----------
        row : of the batch. proposed : the proposal, which is left out. actions : number of actions.
        """
        if self._scores is None:
            self._scores = (ranking_of(self._policy, self._observation),)
        scores = self._scores[0]
        if scores is None or np.atleast_2d(scores).shape[1] != actions:
            return None
        return order_from_scores(np.atleast_2d(scores)[row], proposed)
