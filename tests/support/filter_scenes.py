"""Questions for the predictive filter, recorded while it drives highway-env among traffic."""

from collections.abc import Iterator

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from dynamics.scenes.scene import SceneReader
from dynamics.state import RoadState, Vehicle
from mpc import FilterProblem, FilterSettings, PredictiveFilter

HALF = (4.5, 1.3)
BRAKING, ACCELERATION = 6.0, 1.5
KINDS = ("throttle", "wander", "weave", "wild")


def environment(lanes=4, vehicles=30):
    """highway-v0 with throttle and steering, ten decisions a second of simulated time."""
    action = {"type": "ContinuousAction", "longitudinal": True, "lateral": True}
    config = {"action": action, "lanes_count": lanes, "vehicles_count": vehicles, "policy_frequency": 5, "duration": 60}
    return gym.make("highway-v0", config=config)


def occupancy(scene, settings, most):
    """Rectangles of the `most` nearest others at the end of each stage, (N, m, 4): braking or accelerating, in lane."""
    ego, others = scene.ego_road, scene.others_road
    ahead = others[:, RoadState.S] - ego[RoadState.S]
    same = np.abs(others[:, RoadState.R] - ego[RoadState.R]) < 2.0
    rows = np.flatnonzero((ahead > -60) & (ahead < 150) & ~(same & (ahead < 0)))
    rows = rows[np.argsort(np.abs(ahead[rows]), kind="stable")[:most]]
    s, r, _, v = others[rows].T
    t = settings.stage * np.arange(1, settings.stages + 1)[:, None]
    braking = np.minimum(t, v / BRAKING)
    half = 0.5 * scene.others[rows][:, [Vehicle.LENGTH, Vehicle.WIDTH]].T
    out = np.empty((settings.stages, rows.size, 4))
    out[..., 0] = s + v * braking - 0.5 * BRAKING * braking**2 - half[0]
    out[..., 1] = s + v * t + 0.5 * ACCELERATION * t**2 + half[0]
    out[..., 2], out[..., 3] = r - half[1], r + half[1]
    return out, s + v**2 / (2 * BRAKING) - half[0]


def question(scene, proposal, settings, most=6, half=HALF):
    """The scene and a proposal as a `FilterProblem`."""
    rectangles, rest = occupancy(scene, settings, most)
    centers = scene.road.centers
    edges = (centers[0] - 0.5 * scene.road.width, centers[-1] + 0.5 * scene.road.width)
    return FilterProblem(scene.ego_road.copy(), proposal, rectangles, half, edges, rest=rest)


class Proposals:
    """Proposals of several policies: full throttle, slow wandering, lane changes, uniform noise."""

    def __init__(self, kind, seed):
        self.kind, self.rng, self.kept = kind, np.random.default_rng(seed), np.zeros(2)

    def __call__(self, scene):
        r, psi, v = scene.ego_road[1:]
        if self.kind == "throttle":
            return np.array([5.0, float(np.clip(-0.02 * (r - np.round(r / 4) * 4) - 0.3 * psi, -0.2, 0.2))])
        if self.kind == "wander":
            self.kept = 0.9 * self.kept + self.rng.normal(scale=(1.0, 0.01))
        elif self.kind == "weave":
            if self.rng.random() < 0.1 or not self.kept.any():
                self.kept = np.array([self.rng.uniform(-3, 5), 4.0 * self.rng.integers(0, 4)])
            angle = np.clip(0.15 * (self.kept[1] - r), -2, 2) / max(v, 5.0)
            return np.array([self.kept[0], float(np.clip(0.5 * (angle - psi), -0.2, 0.2))])
        else:
            self.kept = self.rng.uniform((-5, -np.pi / 4), (5, np.pi / 4))
        return np.clip(self.kept, (-5, -np.pi / 4), (5, np.pi / 4))


def record(
    settings: FilterSettings, count: int, kind: str = "weave", seed: int = 0, most: int = 6
) -> Iterator[tuple[FilterProblem, bool]]:
    """`count` questions of one kind of policy, and whether each is the first of an episode."""
    env, driver = environment(), PredictiveFilter(settings)
    made, episode = 0, seed
    while made < count:
        env.reset(seed=episode)
        reader, proposals, first = SceneReader(env), Proposals(kind, episode), True
        driver.reset()
        stored = None
        for _ in range(100):
            scene = reader.read()
            problem = question(scene, proposals(scene), settings, most)
            yield problem, first
            made, first = made + 1, False
            result = driver.solve(problem)
            if result.status.usable:
                stored = result.inputs
                use = stored[0]
            else:
                stored = np.vstack([stored[1:], stored[-1:]]) if stored is not None else None
                use = stored[0] if stored is not None else np.array([settings.acceleration[0], 0.0])
            action = use / (5.0, np.pi / 4)
            if env.step(action)[2] or made >= count:
                break
        episode += 1
    env.close()
