"""What the shield costs, as ratios against the policy and the simulator in the same run, with one thread.

    python benchmarks/ratios.py [--decisions 300]

Absolute times say more about the machine than about the shield; the ratios are what to compare. Pairs that are
compared are measured in turn, decision by decision, so that a busy machine slows both.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from statistics import median
from time import perf_counter
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from stable_baselines3 import PPO

from shield import Shield, ShieldedEnv

IDLE, FASTER = 1, 3
REFERENCE = "ppo-highway-fast"


def reference_policy(env: gym.Env[Any, Any]) -> tuple[str, Any]:
    """The PPO reference policy, or an untrained one of its size."""
    try:
        from evaluation.policies import list_references, load_reference

        if REFERENCE in list_references():
            return REFERENCE, load_reference(REFERENCE)
    except ImportError:
        pass
    net = {"net_arch": {"pi": [256, 256], "vf": [256, 256]}}
    return "untrained PPO [256, 256]", PPO("MlpPolicy", env, policy_kwargs=net, device="cpu", seed=0)


class Timed:
    """A policy that keeps the time that each `predict` of the policy inside took [s]."""

    def __init__(self, policy: Any) -> None:
        self.policy = policy
        self.last = 0.0

    def predict(self, *args: Any, **kwargs: Any) -> Any:
        start = perf_counter()
        out = self.policy.predict(*args, **kwargs)
        self.last = perf_counter() - start
        return out


class Playing:
    """Actions from a function, as a policy."""

    def __init__(self, choose: Callable[[], int]) -> None:
        self._choose = choose

    def predict(self, observation: Any, state: Any = None, **_: Any) -> tuple[Any, Any]:
        return np.asarray(self._choose()), state


def policies(model: Any) -> dict[str, Callable[[], Any]]:
    """Fresh policies by name."""

    def random() -> Playing:
        generator = np.random.default_rng(0)
        return Playing(lambda: int(generator.integers(5)))

    return {
        "ppo": lambda: model,
        "idle": lambda: Playing(lambda: IDLE),
        "faster": lambda: Playing(lambda: FASTER),
        "random": random,
    }


def passed_path(model: Any, decisions: int) -> tuple[list[float], list[float]]:
    """Times of the policy's own `predict`, and what `Shield.predict` adds where the proposal passes [s]."""
    env = gym.make("highway-fast-v0")
    timed = Timed(model)
    shield = Shield(timed, env=env)
    own: list[float] = []
    added: list[float] = []
    seed, warm = 0, 20
    obs, _ = env.reset(seed=seed)
    for i in range(decisions + warm):
        start = perf_counter()
        action, _ = shield.predict(obs, deterministic=True)
        total = perf_counter() - start
        last = shield.last_decision
        if i >= warm and last is not None and last.tier == "passed":
            own.append(timed.last)
            added.append(total - timed.last)
        obs, _, terminated, truncated, _ = env.step(int(action))
        if terminated or truncated:
            seed += 1
            obs, _ = env.reset(seed=seed)
    return own, added


def tight_loop(model: Any, decisions: int) -> tuple[list[float], list[float]]:
    """The same where nothing else runs in between, on one scene after the other: everything is in the caches."""
    env = gym.make("highway-fast-v0")
    timed = Timed(model)
    shield = Shield(timed, env=env)
    own: list[float] = []
    added: list[float] = []
    for seed in range(max(decisions // 10, 1)):
        obs, _ = env.reset(seed=seed)
        for i in range(15):
            start = perf_counter()
            shield.predict(obs, deterministic=True)
            total = perf_counter() - start
            last = shield.last_decision
            if i >= 5 and last is not None and last.tier == "passed":
                own.append(timed.last)
                added.append(total - timed.last)
    return own, added


def step_share(policy: Any, decisions: int) -> tuple[list[float], list[float], list[float]]:
    """Wall time of a shielded and of a bare `step`, same seeds and executed actions; and the time inside [s]."""
    shielded, bare = ShieldedEnv(gym.make("highway-fast-v0")), gym.make("highway-fast-v0")
    with_shield: list[float] = []
    without: list[float] = []
    inside: list[float] = []
    seed, warm, i = 0, 10, 0
    obs, _ = shielded.reset(seed=seed)
    bare.reset(seed=seed)
    while len(with_shield) < decisions:
        action = int(policy.predict(obs, deterministic=True)[0])
        start = perf_counter()
        obs, _, terminated, truncated, _ = shielded.step(action)
        middle = perf_counter()
        executed = int(shielded.last_decision.executed) if shielded.last_decision else action
        # The bare step, too, comes right after the policy has run, as it does where one drives.
        policy.predict(obs, deterministic=True)
        again = perf_counter()
        _, _, ended, cut, _ = bare.step(executed)
        end = perf_counter()
        i += 1
        if i > warm:
            with_shield.append(middle - start)
            without.append(end - again)
            inside.append(shielded.latency)
        if terminated or truncated or ended or cut:
            seed += 1
            obs, _ = shielded.reset(seed=seed)
            bare.reset(seed=seed)
    return with_shield, without, inside


def latencies(policy: Any, wrapper: str, decisions: int) -> tuple[list[float], float]:
    """Latency of each decision among 20 vehicles [s], and the share of decisions that were overridden."""
    env: Any = gym.make("highway-fast-v0")
    actor: Any = policy
    if wrapper == "ShieldedEnv":
        env = ShieldedEnv(env)
    else:
        actor = Shield(policy, env=env)
    times: list[float] = []
    overridden, seed, warm, i = 0, 0, 10, 0
    obs, _ = env.reset(seed=seed)
    while len(times) < decisions:
        action = int(actor.predict(obs, deterministic=True)[0])
        obs, _, terminated, truncated, _ = env.step(action)
        last = env.last_decision if wrapper == "ShieldedEnv" else actor.last_decision
        i += 1
        if i > warm:
            times.append(last.latency)
            overridden += last.overridden
        if terminated or truncated:
            seed += 1
            obs, _ = env.reset(seed=seed)
    return times, overridden / decisions


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--decisions", type=int, default=300, help="decisions per measurement")
    decisions = parser.parse_args().decisions
    torch.set_num_threads(1)
    name, model = reference_policy(gym.make("highway-fast-v0"))
    make = policies(model)
    table = Table("what", "measured", "value", title=f"highway-fast-v0, one thread, policy: {name}")

    for where, measure in (("while driving", passed_path), ("in a tight loop", tight_loop)):
        own, added = measure(model, decisions)
        table.add_row(f"policy's predict, {where}", "median", f"{1e6 * median(own):.0f} µs")
        table.add_row("Shield.predict, passed, less the policy", "median", f"{1e6 * median(added):.0f} µs")
        table.add_row("", "ratio to the policy's predict", f"[bold]{median(added) / median(own):.2f}[/bold]")
        table.add_section()
    for policy in ("ppo", "idle"):
        with_shield, without, inside = step_share(make[policy](), decisions)
        bare = median(without)
        table.add_row(f"env.step, {policy}", "median, bare", f"{1e3 * bare:.2f} ms")
        table.add_row("", "ShieldedEnv adds, wall, of sums", f"[bold]{sum(with_shield) / sum(without) - 1:+.1%}[/bold]")
        paired = median([a / b for a, b in zip(with_shield, without, strict=True)]) - 1
        table.add_row("", "ShieldedEnv adds, wall, median of pairs", f"{paired:+.1%}")
        table.add_row("", "time inside the shield / bare, of sums", f"{sum(inside) / sum(without):.1%}")
    table.add_section()
    for wrapper in ("Shield", "ShieldedEnv"):
        for policy in ("faster", "random"):
            times, share = latencies(make[policy](), wrapper, decisions)
            p50, p99 = np.percentile(times, [50, 99])
            what = f"decision of {wrapper}, {policy}, {share:.0%} overridden"
            table.add_row(what, "p50 / p99", f"{1e3 * p50:.2f} / {1e3 * p99:.2f} ms")
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
