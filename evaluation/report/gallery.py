"""Pictures of decisions in simulated traffic, one for each road: proposal, executed action, and predicted traffic."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from highway_env.envs.common.action import DiscreteMetaAction
from PIL import Image, ImageDraw

from evaluation.names import FIRST_EVALUATION_SEED
from evaluation.report.draw import font
from evaluation.report.overlay import ShieldOverlay
from evaluation.report.plots import picture_path
from evaluation.running.named_policies import make_policy
from evaluation.settings import Setting
from shield import Shield, ShieldConfig
from shield.decision import Tier
from shield.errors import ConfigError

__all__ = ["ROADS", "draw_gallery", "draw_override"]

ROADS = ("merge-v0", "roundabout-v0", "exit-v0", "two-way-v0", "u-turn-v0", "intersection-v0")
_SEARCH = 5
"""Number of episodes that are searched for the executed alternative with the least margin."""
_SCREEN = {"screen_width": 600, "screen_height": 300, "centering_position": [0.5, 0.5], "scaling": 5.5}
_PANEL, _GAP, _COLORS = (800, 475), 10, 256
_TITLE, _LETTERS = 34, 20
"""Height of the strip with the road's name above a picture, and of its letters [px]."""


def draw_override(env_id: str, policy: str = "faster", seed: int = 0) -> Image.Image:
    """Draw the overridden decision of a few episodes in which the ego passes others most closely.

    Parameters
    ----------
    env_id : an environment with meta-actions that `ShieldConfig.simulated_traffic()` supports.
    policy : name of a policy.
    seed : seed of the first episode.

    Returns
    -------
    The picture.

    Raises
    ------
    ConfigError
        If no decision is overridden, the seeds belong to the evaluation, or the traffic cannot be simulated.
    """
    if not 0 <= seed <= FIRST_EVALUATION_SEED - _SEARCH:
        raise ConfigError(f"have a seed from 0 to {FIRST_EVALUATION_SEED - _SEARCH}, not {seed}")
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    raw = Setting(env_id, env_id, _SCREEN).make("rgb_array")
    if not isinstance(cast(Any, raw.unwrapped).action_type, DiscreteMetaAction):
        raise ConfigError(f"the gallery draws meta-actions, which {env_id} does not take; have {', '.join(ROADS)}")
    shield = Shield(make_policy(policy, raw), raw, ShieldConfig.simulated_traffic().replace(record=True), frames=False)
    env = ShieldOverlay(raw, shield)
    best: tuple[float, Any] = np.inf, None
    try:
        for each in range(seed, seed + _SEARCH):
            observation, _ = env.reset(seed=each)
            done = False
            while not done:
                action = shield.predict(observation)[0]
                decision = shield.last_decision
                if decision is not None and decision.tier is Tier.ALTERNATIVE and decision.margin < best[0]:
                    env.mark()
                    best = decision.margin, env.render()
                observation, _, terminated, truncated, _ = env.step(int(cast(Any, action)))
                done = terminated or truncated
    finally:
        env.close()
    if best[1] is None:
        raise ConfigError(f"{policy} was not overridden in {_SEARCH} episodes of {env_id}; try another policy or seed")
    return Image.fromarray(best[1])


def draw_gallery(path: str | Path, env_ids: Sequence[str] = ROADS, seed: int = 0) -> Path:
    """Draw an override on each road, under its name, in two columns.

    The policy is always FASTER; on the exit it is always LANE_RIGHT.

    Parameters
    ----------
    path : path of the .png file.
    env_ids, seed : see `draw_override`.

    Returns
    -------
    The path.

    Raises
    ------
    ConfigError
        If the file is no .png, or `draw_override` finds nothing.
    """
    path = picture_path(path)
    panels = [draw_override(each, "right" if each.startswith("exit") else "faster", seed) for each in env_ids]
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    (width, height), gap = (_PANEL[0], _TITLE + _PANEL[1]), _GAP
    sheet = Image.new("RGB", (columns * (width + gap) - gap, rows * (height + gap) - gap), (255, 255, 255))
    pen = ImageDraw.Draw(sheet)
    for k, (env_id, panel) in enumerate(zip(env_ids, panels, strict=True)):
        x, y = (k % columns) * (width + gap), (k // columns) * (height + gap)
        pen.text((x + _GAP, y + _TITLE // 2), env_id, font=font(_LETTERS, bold=True), fill=(0, 0, 0), anchor="lm")
        sheet.paste(panel.resize(_PANEL, Image.Resampling.LANCZOS), (x, y + _TITLE))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.quantize(_COLORS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(path, optimize=True)
    return path
