"""Films of shielded episodes, frame by frame at the simulation frequency.

Rendering is off-screen and needs no display.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
from highway_env.envs.exit_env import ExitEnv
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.two_way_env import TwoWayEnv
from PIL import Image

from dynamics.state import RoadState
from evaluation.names import FIRST_EVALUATION_SEED
from evaluation.report.camera import Camera
from evaluation.report.draw import AREA, GREEN, ORANGE, PROPOSAL, RED, Shot, draw
from evaluation.report.plots import picture_path
from evaluation.running.named_policies import make_policy, start_episode
from evaluation.running.records import config_on
from evaluation.settings import Setting, get_setting
from shield import ShieldConfig, ShieldedEnv, Tier
from shield.decision import Intervention
from shield.errors import ConfigError
from shield.filters.network import NetworkFilter

__all__ = [
    "FILM_POLICY",
    "FILM_SETTING",
    "Film",
    "film_end",
    "film_override",
    "film_path",
    "find_override",
    "record",
    "still_of_override",
]

FILM_SETTING = "abz-idm"
FILM_POLICY = "dqn-abz-adversarial"
"""Default policy of a film: an agent trained to crash."""

_FREQUENCY = 15
"""Least simulation frequency of a film [Hz]; at 5 Hz, as in highway-fast-v0, it would not look smooth."""
_CLIP = 9
"""Length of a film [s]."""
_LEAD = 1
"""Time shown before the first override [s]."""
_WANTED = 3
"""Number of overridden decisions in one clip that ends the search for a seed."""
_SEARCH = 30
"""Largest number of seeds in the search; then the best of them is taken."""
_COLORS = 96


@dataclass(frozen=True, slots=True)
class Film:
    """A film that was written.

    Attributes
    ----------
    path : path of the file.
    seed : seed of the episode.
    overrides : number of overridden decisions in it.
    frames : number of pictures.
    """

    path: Path
    seed: int
    overrides: int
    frames: int


_ROAD = {"screen_width": 1100, "screen_height": 150, "scaling": 9.0, "centering_position": [0.2, 0.5]}
_TRACK = {"screen_width": 1000, "screen_height": 500, "scaling": 9.0, "centering_position": [0.5, 0.5]}
"""Layout of pictures: a strip along a straight road, and the surroundings of the ego on other roads."""
_STRAIGHT = (HighwayEnv, TwoWayEnv)


def _filmed(setting: Setting, smooth: bool = True) -> Setting:
    """The setting for a film: large pictures, and a high simulation frequency, which changes the episode."""
    frequency = {"simulation_frequency": max(_FREQUENCY, setting.configured.get("simulation_frequency", 0))}
    env = setting.make()
    straight = isinstance(env.unwrapped, _STRAIGHT) and not isinstance(env.unwrapped, ExitEnv)
    env.close()
    return setting.override(
        {
            **(frequency if smooth else {}),
            **(_ROAD if straight else _TRACK),
            "offscreen_rendering": True,
        }
    )


def record(
    setting: str | Setting,
    policy: str,
    seed: int,
    *,
    first: int = 0,
    last: int | None = None,
    config: ShieldConfig | str | None = None,
    smooth: bool = True,
) -> list[Shot]:
    """Drive a shielded episode and keep a shot of each simulation frame.

    Parameters
    ----------
    setting : a setting, or its name.
    policy : name of a policy.
    seed : seed of the episode.
    first, last : range of decisions to keep; `last` is exclusive.
    config : the shield's settings; its default for the environment if None.
    smooth : whether to raise the simulation frequency for smooth pictures.
    """
    setting = get_setting(setting) if isinstance(setting, str) else setting
    with _shielded(_filmed(setting, smooth), policy, seed, config, "rgb_array") as (env, decide):
        camera = Camera(env)
        shots: list[Shot] = []
        step, done = 0, False
        while not done and (last is None or step < last):
            camera.start(keep=step >= first)
            done = decide()
            shots += camera.develop()
            step += 1
        return shots


@contextmanager
def _shielded(
    setting: Setting, policy: str, seed: int, config: ShieldConfig | str | None, render_mode: str | None
) -> Iterator[tuple[ShieldedEnv, Callable[[], bool]]]:
    """Start a shielded episode, which records decisions if it renders.

    Yields
    ------
    The environment, and a function that executes the next decision and returns whether the episode has ended.
    """
    bare = setting.make(render_mode=render_mode)
    try:
        driver = make_policy(policy, bare)
        if config is None:
            config = config_on(setting)
        env = ShieldedEnv(bare, config, policy=driver)
        if render_mode is not None:
            env.record()
        obs, _ = env.reset(seed=seed)
        start_episode(driver, seed)

        def decide() -> bool:
            nonlocal obs
            action, _ = driver.predict(obs, deterministic=True)
            obs, _, terminated, truncated, _ = env.step(action)
            return terminated or truncated

        yield env, decide
    finally:
        bare.close()


def _overridden(setting: Setting, policy: str, seed: int) -> tuple[list[bool], int]:
    """For each decision of an episode, whether it was overridden; and the number of decisions in a second.

    An override is another action, or on a road network also other inputs in a frame. Nothing is drawn.
    """
    with _shielded(_filmed(setting), policy, seed, None, None) as (env, decide):
        flags, done = [], False
        while not done:
            done = decide()
            assert env.last_decision is not None
            done_to_it, roads = env.last_decision.intervention, isinstance(env.filter, NetworkFilter)
            flags.append(done_to_it is Intervention.OTHER_ACTION or (roads and done_to_it is Intervention.HELD_BACK))
        return flags, _rate(env)


def _rate(env: gym.Env[Any, Any]) -> int:
    """Number of decisions in a second."""
    return int(max(1, round(cast(Any, env.unwrapped).config["policy_frequency"])))


def _best_clip(flags: Sequence[bool], rate: int = 1) -> tuple[int, int]:
    """First decision of the clip with the most overrides, after a passed decision; and the number of overrides.

    `rate` is the number of decisions in a second.
    """
    lead, clip = _LEAD * rate, _CLIP * rate
    starts = [i for i in range(len(flags)) if not flags[i] and any(flags[i + 1 : i + 1 + lead])]
    counts = [(sum(flags[i : i + clip]), -i) for i in starts]
    if not counts:
        return 0, 0
    count, negative = max(counts)
    return -negative, count


def find_override(setting: str | Setting = FILM_SETTING, policy: str = FILM_POLICY, seed: int = 0) -> tuple[int, int]:
    """Seed and first decision of an episode with several overrides, tried from `seed` upwards.

    Raises
    ------
    ConfigError
        If no episode has an override, or the seeds belong to the evaluation.
    """
    setting = get_setting(setting) if isinstance(setting, str) else setting
    count, chosen, start = _most_overridden(setting, policy, seed, _silent)
    if count == 0:
        raise ConfigError(f"{policy} was not overridden in {_SEARCH} episodes of {setting.name}")
    return chosen, start


def _most_overridden(
    setting: Setting, policy: str, seed: int, progress: Callable[[int, int], None]
) -> tuple[int, int, int]:
    """The most overridden decisions in one clip, its seed and its first decision; `seed` and 0 without any.

    Parameters
    ----------
    setting, policy, seed : as in `find_override`.
    progress : called before each episode with the number of tried episodes, and the largest number of them.

    Raises
    ------
    ConfigError
        If the seeds belong to the evaluation.
    """
    if not 0 <= seed <= FIRST_EVALUATION_SEED - _SEARCH:
        raise ConfigError(
            f"episodes are chosen among seeds below {FIRST_EVALUATION_SEED}, not {seed}:"
            " the others are kept for evaluation"
        )
    best = (0, seed, 0)
    for tried in range(_SEARCH):
        progress(tried, _SEARCH)
        start, count = _best_clip(*_overridden(setting, policy, seed + tried))
        if count > best[0]:
            best = (count, seed + tried, start)
        if count >= _WANTED:
            break
    return best


def _silent(tried: int, most: int) -> None:
    """Show no progress."""


def _decisions(setting: str | Setting) -> int:
    """Number of decisions in a clip."""
    setting = get_setting(setting) if isinstance(setting, str) else setting
    env = setting.make()
    try:
        return _CLIP * _rate(env)
    finally:
        env.close()


def film_override(
    path: str | Path,
    setting: str | Setting = FILM_SETTING,
    policy: str = FILM_POLICY,
    seed: int = 0,
    progress: Callable[[int, int], None] = _silent,
) -> Film:
    """Find an episode with overrides, and write it as a GIF; without any override, the first episode.

    Parameters
    ----------
    path : path of the .gif file.
    setting : a setting, or its name.
    policy : name of a policy.
    seed : first seed of the search; below 10,000.
    progress : called before each episode of the search with the number of tried episodes, and the largest number of
        them.

    Raises
    ------
    ConfigError
        If the file is no .gif, or the seeds belong to the evaluation.
    """
    path = film_path(path)
    setting = get_setting(setting) if isinstance(setting, str) else setting
    _, chosen, start = _most_overridden(setting, policy, seed, progress)
    shots = record(setting, policy, chosen, first=start, last=start + _decisions(setting))
    path.parent.mkdir(parents=True, exist_ok=True)
    _write_gif(path, [draw(shot) for shot in shots], 1000 * shots[0].dt)
    overrides = len({id(s.decision) for s in shots if s.decision.overridden})
    return Film(path, chosen, overrides, len(shots))


def film_path(path: str | Path) -> Path:
    """The path of a film.

    Raises
    ------
    ConfigError
        If it is no .gif.
    """
    path = Path(path)
    if path.suffix != ".gif":
        raise ConfigError(f"a film is written as .gif, not {path.suffix or 'without an ending'!r}")
    return path


def film_end(
    path: str | Path, setting: str | Setting, policy: str, seed: int, config: ShieldConfig | str | None = None
) -> Film:
    """Write the last seconds of an episode as a GIF, at the setting's own simulation frequency.

    Parameters
    ----------
    path : path of the .gif file.
    setting, policy, seed : as in `record`.
    config : the shield's settings; its default for the environment if None.
    """
    path = film_path(path)
    shots = record(setting, policy, seed, config=config, smooth=False)
    shots = shots[-round(_CLIP / shots[0].dt) :]
    path.parent.mkdir(parents=True, exist_ok=True)
    _write_gif(path, [draw(shot) for shot in shots], 1000 * shots[0].dt)
    overrides = len({id(s.decision) for s in shots if s.decision.overridden})
    return Film(path, seed, overrides, len(shots))


def still_of_override(
    path: str | Path, setting: str | Setting = "highway-fast", policy: str = "faster", seed: int = 5
) -> Path:
    """Write one picture of an override whose path avoids the collision of the proposal by another lane.

    Parameters
    ----------
    path : path of the .png file.
    setting : a setting, or its name.
    policy : name of a policy.
    seed : first seed of the search; below 10,000.

    Returns
    -------
    The path.

    Raises
    ------
    ConfigError
        If the file is no .png, or no override of some episodes has such a path.
    """
    path = picture_path(path)
    for candidate in range(seed, seed + _SEARCH):
        best = max(record(setting, policy, candidate), key=_shows)
        if _shows(best)[0]:
            break
    else:
        raise ConfigError(f"no override of {policy} led around anything in {_SEARCH} episodes")
    path.parent.mkdir(parents=True, exist_ok=True)
    draw(best).save(path, optimize=True)
    return path


def _shows(shot: Shot) -> tuple[bool, float]:
    """Whether a shot is the first of another action, with a path a lane off the proposal's; and how early it is."""
    decision, apart = shot.decision, 0.0
    if shot.proposal is not None and decision.plan is not None and len(decision.plan) > shot.period:
        apart = abs(float((decision.plan[shot.period] - shot.proposal[-1])[RoadState.R]))
    begun = decision.tier is Tier.ALTERNATIVE and shot.acting is decision and shot.age == 0
    return begun and decision.occupancy is not None and apart > shot.size[1], -shot.time


def _write_gif(path: Path, pictures: Sequence[Image.Image], duration: float) -> None:
    """Write a GIF with one palette and without dithering: small files that do not flicker."""
    parts = [np.asarray(picture) for picture in pictures[:: len(pictures) // 6 + 1]]
    signals = np.repeat(np.array([GREEN, ORANGE, RED, AREA, PROPOSAL], dtype=np.uint8), 4, axis=0)
    width = parts[0].shape[1]
    parts.append(np.tile(signals[:, None, :], (1, width, 1)))
    palette = Image.fromarray(np.concatenate(parts)).quantize(
        _COLORS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    )
    frames = [p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=duration, loop=0, optimize=True)
