"""What a world model imagines after some frames, beside what happens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from dynamics.state import FloatArray, IntArray
from dynamics.world_model.model import WorldModel
from dynamics.world_model.networks import Decoder
from dynamics.world_model.view import OTHERS, RELATIVE_SPEED
from evaluation.running.frame_episodes import frame_world
from evaluation.settings import Setting
from evaluation.threads import one_thread
from mpc.latent.driver import LatentDriver
from shield.errors import ConfigError

__all__ = ["AHEAD", "Dream", "Imagination", "dream", "imagination_quality"]

AHEAD = (1, 3, 10)
"""Decisions ahead at which imagined occupancy is measured."""
_OCCUPIED = 0.5
"""Share of a cell from which it counts as occupied."""


@dataclass(frozen=True)
class Dream:
    """An episode from decision 0 on, of which the model sees the first `context` frames.

    Attributes
    ----------
    frames : real frames, (n, channels, size, size) uint8.
    actions : actions of the decisions between them, (n - 1,).
    occupancy : of others, decoded, (n, rows, columns): of seen frames up to `context`, imagined from there on.
    context : number of seen frames.
    imagined_rewards : of the actions from `context` - 1 on. real_rewards : of all actions.
    """

    frames: NDArray[np.uint8]
    actions: IntArray
    occupancy: FloatArray
    context: int
    imagined_rewards: FloatArray
    real_rewards: FloatArray


def dream(driver: LatentDriver, setting: Setting, seed: int, context: int, steps: int) -> Dream:
    """Drive an episode, and imagine its decisions after `context` frames with the same actions.

    Parameters
    ----------
    context : frames that the model sees, at least 1.
    steps : imagined decisions, at least 1; the episode may end before.

    Raises
    ------
    ConfigError
        If a number is less than 1, or the episode ends before the first imagined decision.
    """
    if context < 1 or steps < 1:
        raise ConfigError(f"a dream has at least 1 seen frame and 1 imagined decision, not {context} and {steps}")
    frames, actions, rewards = _episode(driver, setting, seed, context + steps)
    if len(frames) <= context:
        raise ConfigError(f"the episode of seed {seed} ends after {len(frames)} frames; see fewer than that first")
    with torch.no_grad(), one_thread():
        model, grids, imagined = driver.model, [], []
        h = model.blank(1)
        for t, frame in enumerate(frames):
            if t < context:
                state = model.posterior_state(h, model.embed(torch.from_numpy(frame[None])))
            else:
                state = model.imagine(state, torch.tensor(actions[t - 1 : t]))
                imagined.append(float(model.outcomes(state.features).reward))
            grids.append(_occupancy(model, state.features)[0])
            if t < context and t < len(actions):
                h = model.advance(state, torch.tensor(actions[t : t + 1]))
    return Dream(frames, actions, np.stack(grids), context, np.array(imagined), rewards)


def _occupancy(model: WorldModel, features: torch.Tensor) -> NDArray[np.float32]:
    found: NDArray[np.float32] = model.decode(features)[:, model.config.decoded.index(OTHERS)].numpy()
    return found


def _episode(driver: LatentDriver, setting: Setting, seed: int, most: int) -> tuple[Any, Any, Any]:
    """Frames of an episode of at most `most` decisions, and the actions and rewards between them."""
    world = frame_world(setting, 1, driver.model.config.view)
    world.seed(seed)
    observation: Any = world.reset()
    state, over = None, False
    frames: list[Any] = [observation[0]]
    actions: list[int] = []
    rewards: list[float] = []
    while not over and len(frames) < most:
        action, state = driver.predict(observation, state, np.array([not actions]), deterministic=True)
        observation, reward, done, infos = world.step(action)
        over = bool(done[0])
        frames.append(infos[0]["terminal_observation"] if over else observation[0])
        actions.append(int(action[0]))
        rewards.append(float(reward[0]))
    return np.stack(frames), np.array(actions, np.int64), np.array(rewards)


@dataclass(frozen=True)
class Imagination:
    """Intersection over union of occupied cells, some decisions ahead.

    Attributes
    ----------
    ahead : decisions.
    imagined : of the cells that the model takes for the most likely, as many as are occupied in the episode.
    constant_velocity : of others that keep their speed relative to the ego.
    mean_map : of the cells that are occupied most often, as many as are occupied.
    """

    ahead: int
    imagined: float
    constant_velocity: float
    mean_map: float


def imagination_quality(driver: LatentDriver, setting: Setting, seeds: range, period: float = 1.0) -> list[Imagination]:
    """Measure imagined occupancy on episodes of the driver, after every frame.

    Parameters
    ----------
    period : duration of a decision [s].
    """
    episodes = [_episode(driver, setting, seed, 1_000)[:2] for seed in seeds]
    # The cells of the decoder, of all frames.
    cells = [_cells(frames, driver) for frames, _ in episodes]
    mean = np.concatenate([grid[:, 0] for grid in cells]).mean(0)
    found = []
    for ahead in AHEAD:
        scores = np.zeros((3, 2))
        for (frames, actions), grid in zip(episodes, cells, strict=True):
            if len(frames) <= ahead:
                continue
            truth = grid[ahead:, 0] >= _OCCUPIED
            share = float(truth.mean())
            guesses = (
                _most(_imagined(driver.model, frames, actions, ahead), share),
                _moved(grid[:-ahead], driver, ahead * period) >= _OCCUPIED,
                np.broadcast_to(_most(mean, share), truth.shape),
            )
            for row, guess in zip(scores, guesses, strict=True):
                row += (guess & truth).sum(), (guess | truth).sum()
        found.append(Imagination(ahead, *(float(a / max(b, 1)) for a, b in scores)))
    return found


def _most(likely: NDArray[Any], share: float) -> NDArray[np.bool_]:
    """The most likely cells, a share of all."""
    found: NDArray[np.bool_] = likely >= np.quantile(likely, 1 - share)
    return found


def _cells(frames: NDArray[np.uint8], driver: LatentDriver) -> NDArray[np.float32]:
    """Occupancy and relative speed of others in the decoder's grid, (n, 2, rows, columns)."""
    found: NDArray[np.float32] = Decoder.target(torch.from_numpy(frames[:, [OTHERS, RELATIVE_SPEED]])).numpy()
    return found


def _imagined(model: WorldModel, frames: NDArray[np.uint8], actions: IntArray, ahead: int) -> NDArray[np.float32]:
    """Occupancy imagined `ahead` decisions after each frame of an episode."""
    taken = torch.from_numpy(actions)
    with torch.no_grad(), one_thread():
        padded = torch.cat([taken, taken.new_zeros(1)])[None]
        first = torch.zeros(1, len(frames), dtype=torch.bool)
        first[0, 0] = True
        state = model.observe(torch.from_numpy(frames)[None], padded, first).state[0, : len(frames) - ahead]
        for k in range(ahead):
            state = model.imagine(state, taken[k : k + len(state.h)])
        return _occupancy(model, state.features)


def _moved(cells: NDArray[np.float32], driver: LatentDriver, seconds: float) -> NDArray[np.float32]:
    """Occupied cells moved along the road by their relative speeds."""
    view = driver.model.config.view
    columns = cells.shape[-1]
    length = (view.ahead + view.behind) / columns
    speed = np.where(cells[:, 0] > 0, cells[:, 1] / np.maximum(cells[:, 0], 1e-6), 0) * 255
    shift = (np.clip(speed, 0, 255) - 128) / 127 * view.relative_speed * seconds / length
    n, row, column = np.nonzero(cells[:, 0] >= _OCCUPIED)
    target = np.rint(column + shift[n, row, column]).astype(int)
    inside = (target >= 0) & (target < columns)
    moved = np.zeros_like(cells[:, 0])
    moved[n[inside], row[inside], target[inside]] = 1
    return moved
