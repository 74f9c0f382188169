"""How well it is told in which lane somebody will be in 2 s: episodes of highway-fast-v0, always FASTER behind the
shield, each vehicle that is seen at each frame. By the tracker's estimate (`shield.perception.intent`), by +1, 0
and -1 (a lane further where |vy| > 0.3 m/s), by who is taken to stay in its lane, each of what is shown and of what the
tracker makes of it, and by the lane that it steers for already, which the simulator alone knows. And how often who is
said to be within 2 m with some probability is.

    python benchmarks/intent.py [--episodes 30] [--seed 402000] [--sensors exact,metric-0.5] [--fit]

`--fit` looks for the constants of `LANE_CHANGE_MODEL` instead: least Brier score, the geometric mean over the sensors.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from scipy.optimize import minimize

from dynamics.state import BoolArray, FloatArray, IntArray
from evaluation.settings import get_setting
from evaluation.wrappers import SENSORS, SensorNoise
from shield import ShieldedEnv
from shield.perception.certainty import probability_within
from shield.perception.intent import LaneChangeModel, lane_chances, lane_change_gains
from shield.perception.scenes import ObservedScenes
from shield.perception.sighting import decode
from shield.perception.tracking import Tracks

AHEAD = 2.0
"""How far ahead is asked [s]."""
FIRST = 5
"""Who is seen within so many frames of the reset is not counted: the tracker has to get to know them, and the traffic,
which begins too dense, to spread."""
NEAR = 2.0
"""Who is no further than this from where the tracker has it is near [m]."""
THRESHOLD = 0.3


class Standing(gym.Wrapper[Any, Any, Any, Any]):
    """An environment that a sensor in front of it does not reset."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        return self.unwrapped.observation_type.observe(), {}  # type: ignore[attr-defined]


@dataclass
class Seen:
    """Everybody who was followed, at each frame: who, when, what was shown, and what the tracker has of them."""

    who: list[tuple[int, int, int]] = field(default_factory=list)
    shown: list[FloatArray] = field(default_factory=list)
    places: list[FloatArray] = field(default_factory=list)
    tracks: list[tuple[FloatArray, FloatArray, FloatArray]] = field(default_factory=list)
    wished: list[FloatArray] = field(default_factory=list)

    def all_tracks(self) -> Tracks:
        chances, means, covariances = (np.stack(each) for each in zip(*self.tracks, strict=True))
        return Tracks(means=means, covariances=covariances, chances=chances)


def watch(names: Iterable[str], seeds: Iterable[int]) -> tuple[dict[str, Seen], FloatArray, dict[int, FloatArray]]:
    """Drive; what each sensor shows of whom, the middles of the lanes, and of each episode where everybody is across
    and for which lane they steer, by frames, (frames, vehicles, 2)."""
    env = get_setting("highway-fast-seen").make()
    shielded, base = ShieldedEnv(env), env.unwrapped
    eyes = {name: SensorNoise(Standing(env), SENSORS[name]) for name in names}
    scenes = {name: ObservedScenes(eye) for name, eye in eyes.items()}
    seen, across = {name: Seen() for name in names}, {}
    centers = 4.0 * np.arange(base.config["lanes_count"])
    for seed in seeds:
        shielded.reset(seed=seed)
        for name, eye in eyes.items():
            eye.reset(seed=seed)
            scenes[name].check()
        cars, frames = list(base.road.vehicles), []
        step = base.road.step

        def look(dt: float) -> None:
            step(dt)  # noqa: B023
            ego, k = base.vehicle, len(frames)  # noqa: B023
            frames.append([[car.position[1], car.target_lane_index[2]] for car in cars])  # noqa: B023
            close = base.road.close_objects_to(ego, base.PERCEPTION_DISTANCE, count=14, see_behind=True, sort=True)
            exact = base.observation_type.observe()
            for name, eye in eyes.items():
                observation = eye.observation(exact)
                scenes[name].show(observation)
                scenes[name].read()
                note(seen[name], scenes[name], observation, (seed, k), [cars.index(car) for car in close])  # noqa: B023
                perception = scenes[name].perception
                x, y, heading, speed = perception.ego[:4]
                state = np.array([x, y, speed * np.cos(heading), speed * np.sin(heading)])
                wished = lane_change_gains(perception.tracks, state, centers)
                seen[name].wished.extend(wished[perception.tracks.missed == 0])
                rows = rows_of(scenes[name])
                seen[name].places.extend(close[int(r) - 1].position - [ego.position[0], 0.0] for r in rows)

        base.road.step = look
        over = False
        while not over:
            *_, terminated, truncated, _ = shielded.step(3)
            over = terminated or truncated
        across[seed] = np.array(frames)
    return seen, centers, across


def rows_of(scenes: ObservedScenes) -> FloatArray:
    """In which row each is who is seen now."""
    tracks = scenes.perception.tracks
    return tracks.places[tracks.missed == 0]


def note(seen: Seen, scenes: ObservedScenes, observation: Any, when: tuple[int, int], cars: list[int]) -> None:
    """Keep what is known of those who are seen now."""
    perception = scenes.perception
    tracks, sighting = perception.tracks, decode(perception.spec, observation)
    for i in np.flatnonzero(tracks.missed == 0):
        row = int(tracks.places[i])
        seen.who.append((*when, cars[row - 1]))
        seen.shown.append(sighting.others[sighting.places.tolist().index(row)])
        means = tracks.means[i].copy()
        means[:, 0] -= perception.ego[0]
        seen.tracks.append((tracks.chances[i].copy(), means, tracks.covariances[i].copy()))


def lane_of(y: FloatArray, centers: FloatArray) -> IntArray:
    return np.abs(np.asarray(y)[..., None] - centers).argmin(axis=-1)


def sure(lanes: IntArray, n: int) -> FloatArray:
    return np.eye(n)[lanes]


def signed(y: FloatArray, vy: FloatArray, centers: FloatArray) -> FloatArray:
    """What the channel of +1, 0 and -1 says."""
    sign = np.where(np.abs(vy) > THRESHOLD, np.sign(vy), 0).astype(int)
    return sure(np.clip(lane_of(y, centers) + sign, 0, len(centers) - 1), len(centers))


@dataclass
class Outcome:
    """What those who were seen did: their lanes then and after, for how many that is known, and the changes."""

    now: IntArray
    then: IntArray
    steers: IntArray
    known: BoolArray
    changes: list[tuple[list[int], int]]


def outcome(seen: Seen, centers: FloatArray, across: dict[int, FloatArray], ahead: int) -> Outcome:
    now, then, steers, known = [], [], [], []
    at = {who: i for i, who in enumerate(seen.who)}
    for seed, frame, car in seen.who:
        path = across[seed]
        lanes = lane_of(path[:, car, 0], centers)
        now.append(lanes[frame])
        steers.append(int(path[frame, car, 1]))
        known.append(FIRST <= frame < len(path) - ahead)
        then.append(lanes[min(frame + ahead, len(path) - 1)])
    changes = []
    for seed, path in across.items():
        lanes = lane_of(path[:, :, 0], centers)
        for frame, car in zip(*np.nonzero(np.diff(lanes[FIRST:], axis=0)), strict=True):
            frame = frame + FIRST
            before, k = [], int(frame)
            while (i := at.get((seed, k, int(car)))) is not None and lanes[k, car] == lanes[frame, car]:
                before.append(i)
                k -= 1
            if before:
                changes.append((before, int(lanes[frame + 1, car])))
    return Outcome(np.array(now), np.array(then), np.array(steers), np.array(known), changes)


def score(chances: FloatArray, did: Outcome, dt: float) -> list[float]:
    """Accuracy, of those who change and of those who stay, their mean, Brier score, how many changes were told before
    the line was crossed, and for how long in the mean [s]."""
    known, said = did.known, chances.argmax(axis=1)
    right = (said == did.then)[known]
    changed = (did.now != did.then)[known]
    brier = np.square(chances[known] - np.eye(chances.shape[1])[did.then[known]]).sum(axis=1).mean()
    leads = []
    for before, lane in did.changes:
        told = [said[i] == lane for i in before]
        leads.append(dt * (told.index(False) if False in told else len(told)))
    a, b = right[changed].mean(), right[~changed].mean()
    return [right.mean(), a, b, (a + b) / 2, brier, float(np.mean(np.array(leads) > 0)), float(np.mean(leads))]


def fit(seen: dict[str, Seen], centers: FloatArray, did: dict[str, Outcome]) -> LaneChangeModel:
    def habits(x: FloatArray) -> LaneChangeModel:
        share = 1 / (1 + np.exp(-x[3:]))
        reach, stray, fade = np.exp(x[:3]).tolist()
        eager, idle, doubt = share.tolist()
        return LaneChangeModel(reach, stray, eager, idle, fade, doubt)

    everybody = {name: (each.all_tracks(), np.stack(each.wished)) for name, each in seen.items()}

    def loss(x: FloatArray) -> float:
        found = []
        for name, (tracks, wished) in everybody.items():
            known = did[name].known
            chances = lane_chances(tracks, wished, centers, habits(x))[known]
            found.append(np.square(chances - np.eye(len(centers))[did[name].then[known]]).sum(axis=1).mean())
        # Each sensor counts by the share that is gained.
        return float(np.mean(np.log(found)))

    start = [-0.7, 0.0, 0.0, 1.5, -6.0, -0.5]
    best = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-2, "fatol": 1e-6, "maxfev": 400})
    print(f"least Brier score {np.exp(best.fun):.4f} in the geometric mean, of {best.nfev} tried")
    return habits(best.x)


def table(name: str, seen: Seen, centers: FloatArray, did: Outcome, dt: float) -> None:
    shown, tracks, n = np.stack(seen.shown), seen.all_tracks(), len(centers)
    mean = tracks.mean
    rows: list[tuple[str, FloatArray]] = [
        ("stays, as shown", sure(lane_of(shown[:, 1], centers), n)),
        ("+1, 0, -1, as shown", signed(shown[:, 1], shown[:, 3], centers)),
        ("stays, as tracked", sure(lane_of(mean[:, 1], centers), n)),
        ("+1, 0, -1, as tracked", signed(mean[:, 1], mean[:, 3], centers)),
        ("lane_chances", lane_chances(tracks, np.stack(seen.wished), centers)),
        ("(steers for, true)", sure(did.steers, n)),
    ]
    for label, chances in rows:
        accuracy, changers, stayers, balanced, brier, told, lead = score(chances, did, dt)
        print(
            f"| {name} | {label} | {100 * accuracy:.1f} | {100 * changers:.1f} | {100 * stayers:.1f} |"
            f" {100 * balanced:.1f} | {brier:.3f} | {100 * told:.0f} | {lead:.2f} |"
        )


def reliability(name: str, said: FloatArray, happened: BoolArray, edges: FloatArray) -> None:
    """How often what is said with some probability happens."""
    which = np.clip(np.digitize(said, edges) - 1, 0, len(edges) - 2)
    for k in range(len(edges) - 1):
        here = which == k
        if here.sum() >= 100:
            print(
                f"| {name} | {edges[k]:.1f} to {edges[k + 1]:.1f} | {here.sum():,} | {said[here].mean():.3f} |"
                f" {happened[here].mean():.3f} |"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=30)
    parser.add_argument("--seed", type=int, default=402_000)
    parser.add_argument("--sensors", default="exact,metric-0.5,metric-2,normalised-0.2")
    parser.add_argument("--fit", action="store_true")
    asked = parser.parse_args()
    seen, centers, across = watch(asked.sensors.split(","), range(asked.seed, asked.seed + asked.episodes))
    dt = 0.2
    did = {name: outcome(each, centers, across, round(AHEAD / dt)) for name, each in seen.items()}
    if asked.fit:
        print(fit(seen, centers, did))
        return
    first = next(iter(did.values()))
    changed = (first.now != first.then)[first.known]
    print(
        f"{len(changed):,} vehicle-frames, {changed.sum():,} of them of who changes; {len(first.changes):,} changes\n"
    )
    print("| sensor | told by | right % | who changes % | who stays % | balanced % | Brier | told before % | for s |")
    print("| :-- | :-- | --: | --: | --: | --: | --: | --: | --: |")
    for name, each in seen.items():
        table(name, each, centers, did[name], dt)
    print(f"\n| sensor | {'of being in another lane'} | vehicle-frames | said | was |\n| :-- | :-- | --: | --: | --: |")
    for name, each in seen.items():
        known, now = did[name].known, did[name].now
        other = 1 - lane_chances(each.all_tracks(), np.stack(each.wished), centers)[np.arange(len(now)), now]
        reliability(name, other[known], (did[name].now != did[name].then)[known], np.linspace(0, 1, 6))
    print(f"\n| sensor | of being within {NEAR:g} m | vehicle-frames | said | was |\n| :-- | :-- | --: | --: | --: |")
    for name, each in seen.items():
        tracks, truth = each.all_tracks(), np.stack(each.places)
        reliability(name, probability_within(tracks, NEAR), distance_of(tracks, truth) <= NEAR, np.linspace(0, 1, 11))


def distance_of(tracks: Tracks, truth: FloatArray) -> FloatArray:
    """From where the tracker has them to where they are [m]; x from the ego's, y in the world."""
    return np.hypot(*(tracks.mean[:, :2] - truth).T)


if __name__ == "__main__":
    main()
