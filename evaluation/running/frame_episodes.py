"""Episodes of a policy on frames, side by side in the compiled highway, one for each seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.world_model.view import FrameView
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from evaluation.learning.shielded_vec_env import ShieldedVecEnv
from evaluation.running.named_policies import Policy
from evaluation.settings import Setting
from evaluation.threads import one_thread
from shield.config import ShieldConfig

__all__ = ["FrameEpisodes", "drive_frames", "frame_world"]


@dataclass(frozen=True)
class FrameEpisodes:
    """Results of n episodes.

    Attributes
    ----------
    returns : sum of the rewards. crashed : of the ego. steps : decisions.
    speed : mean of the ego's speeds [m/s].
    overridden : decisions in which the shield executed something else than the proposal; 0 without a shield.
    actions : how often each action was proposed, (n, actions).
    """

    returns: FloatArray
    crashed: BoolArray
    steps: IntArray
    speed: FloatArray
    overridden: IntArray
    actions: IntArray

    @property
    def override_share(self) -> float:
        """Share of all decisions that were overridden."""
        return float(self.overridden.sum() / self.steps.sum())


def frame_world(
    setting: Setting, count: int, view: FrameView | None, shield: ShieldConfig | None = None
) -> FastHighwayVecEnv:
    """Compiled environments of a setting that observe frames of a view, with a shield each if one is given.

    Raises
    ------
    ConfigError
        If the setting or the shield is not supported by the compiled highway.
    """
    if shield is None:
        return FastHighwayVecEnv(count, setting.env_id, setting.configured, frames=view)
    return ShieldedVecEnv(count, setting.env_id, setting.configured, shield, frames=view)


def drive_frames(policy: Policy, world: FastHighwayVecEnv, seeds: range) -> FrameEpisodes:
    """Drive an episode for each seed with the policy's best actions.

    Parameters
    ----------
    policy : its `predict` takes the observations of all environments.
    world : environments, which drive the seeds in batches of as many; at least one.
    """
    parts = [_drive(policy, world, seeds[i : i + world.num_envs]) for i in range(0, len(seeds), world.num_envs)]
    names = ("returns", "crashed", "steps", "speed", "overridden", "actions")
    return FrameEpisodes(**{name: np.concatenate([part[name] for part in parts]) for name in names})


def _drive(policy: Policy, world: FastHighwayVecEnv, seeds: range) -> dict[str, Any]:
    count, n = world.num_envs, len(seeds)
    world.seed(seeds[0])
    with one_thread():
        observations = world.reset()
        going, start, state = np.arange(count) < n, np.ones(count, bool), None
        total, speed = np.zeros(count), np.zeros(count)
        steps, overridden = np.zeros(count, np.intp), np.zeros(count, np.intp)
        crashed, proposed = np.zeros(count, bool), np.zeros((count, world.action_space.n), np.intp)  # type: ignore[attr-defined]
        while going.any():
            actions, state = policy.predict(observations, state, start, deterministic=True)
            actions = np.broadcast_to(actions, (count,))
            which = np.flatnonzero(going)
            observations, rewards, done, infos = world.step_some(actions, which)
            total[which] += rewards[which]
            steps[which] += 1
            proposed[which, actions[which]] += 1
            for i in which:
                speed[i] += infos[i]["speed"]
                overridden[i] += infos[i].get("shield", {}).get("overridden", False)
                crashed[i] |= infos[i]["crashed"]
            start = done
            going &= ~done
    found = {"returns": total, "crashed": crashed, "steps": steps, "speed": speed / np.maximum(steps, 1)}
    found |= {"overridden": overridden, "actions": proposed}
    return {name: values[:n] for name, values in found.items()}
