"""`shield cem-demo`: collect, fit and plan in two minutes; writes a film of parking and a plot of the model's error."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import imageio.v3 as iio
import numpy as np
from PIL import Image, ImageDraw

from dynamics.learned.models.bicycle import BicycleModel
from dynamics.learned.models.model import rollout
from dynamics.learned.tasks import parking_state as parking
from evaluation.running.parking_planner import TrainedParking, train
from evaluation.settings import get_setting
from evaluation.threads import one_thread
from mpc.cem_policy import CEMPolicy
from mpc.tasks.parking_costs import SUCCESS, goal_distance

__all__ = ["cem_demo"]

_STEPS = 15
_SEEDS = range(9000, 9005)
_RGB = (46, 160, 67)


def cem_demo(output: Path, say: Callable[[str], None]) -> list[Path]:
    """Write `parking.gif` and `error.png`.

    Parameters
    ----------
    output : folder; created if it does not exist.
    say : function that prints a line.

    Returns
    -------
    The files.
    """
    output.mkdir(parents=True, exist_ok=True)
    with one_thread():
        trained = train(seed=0)
        say(f"collected {len(trained.data)} transitions, fitted and distilled in {trained.seconds:.0f} s")
        begin = perf_counter()
        frames, starts, actions, after = _drive(trained, say)
        say(f"drove and filmed {len(_SEEDS)} episodes in {perf_counter() - begin:.0f} s")
        film, picture = output / "parking.gif", output / "error.png"
        iio.imwrite(film, np.stack(frames), duration=100, loop=0)
        _plot(trained, starts, actions, after, picture)
    return [film, picture]


def _drive(trained: TrainedParking, say: Callable[[str], None]) -> tuple[list[Any], Any, Any, Any]:
    """Pictures of all episodes; and windows of them: starts (w, 6), actions (w, H, 2), states after (w, H, 6)."""
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    env: Any = get_setting("parking").make(render_mode="rgb_array")
    observation, _ = env.reset(seed=_SEEDS[0])
    policy, frames, parts = CEMPolicy.parking(env, trained.fast), [], []
    for seed in _SEEDS:
        observation, _ = env.reset(seed=seed)
        # highway-env draws nothing under SDL's dummy driver otherwise.
        env.render()
        env.unwrapped.viewer.enabled = True
        state, states, done = None, [parking.state(observation)], False
        info: dict[str, Any] = {}
        taken: list[Any] = []
        while not done:
            action, state = policy.predict(observation, state, np.array([not taken]))
            frames.append(_picture(env, policy, parking.goal(observation)))
            observation, _, terminated, truncated, info = env.step(action)
            states.append(parking.state(observation))
            taken.append(action)
            done = terminated or truncated
        ego = env.unwrapped.vehicle
        ending = "parked" if info["is_success"] else "crashed" if ego.crashed else "ran out of time"
        say(f"  seed {seed}: {ending} after {0.2 * len(taken):.1f} s at {abs(float(ego.speed)):.1f} m/s")
        path, inputs = np.array(states), np.array(taken)
        first = np.arange(max(len(inputs) - _STEPS, 0))
        steps = first[:, None] + np.arange(_STEPS)
        parts.append((path[first], inputs[steps], path[steps + 1]))
    env.close()
    starts, actions, after = (np.concatenate(column) for column in zip(*parts, strict=True))
    return frames, starts, actions, after


def _picture(env: Any, policy: CEMPolicy, goal: Any) -> Any:
    """The scene, with the plan up to the goal as a line; the rest of the plan has no cost and no meaning."""
    image = Image.fromarray(env.render())
    surface, plan = env.unwrapped.viewer.sim_surface, policy.last_plan
    assert plan is not None  # `predict` came before
    path = plan.trajectory[0]
    there = np.flatnonzero(goal_distance(path[None], goal[None])[0] < SUCCESS)
    path = path[: there[0] + 1] if there.size else path
    points = np.concatenate([env.unwrapped.vehicle.position[None], path[:, :2]])
    pixels = [(float(x), float(y)) for x, y in (points - surface.origin) * surface.scaling]
    ImageDraw.Draw(image).line(pixels, fill=_RGB, width=2)
    return np.asarray(image)


def _plot(trained: TrainedParking, starts: Any, actions: Any, after: Any, path: Path) -> None:
    """Plot the distance between predicted and true position by time ahead, on driving outside the training data."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3.5), layout="constrained")
    axes = figure.subplots()
    time = parking.DT * np.arange(1, _STEPS + 1)
    models: dict[str, Any] = {"learned": trained.model, "its macro-steps": trained.fast, "true bicycle": BicycleModel()}
    for name, model in models.items():
        reached = np.asarray(rollout(model, starts, actions))
        error = np.hypot(reached[..., 0] - after[..., 0], reached[..., 1] - after[..., 1])
        axes.plot(time, np.median(error, axis=0), label=name)
    axes.set(xlabel="time ahead [s]", ylabel="median position error [m]", ylim=(0, None))
    axes.legend(frameon=False)
    figure.savefig(path, dpi=120)
