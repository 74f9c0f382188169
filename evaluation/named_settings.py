"""The table of the named settings, and shared configurations."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from evaluation.setting import TRAFFIC, Setting

__all__ = ["SETTINGS"]

_ABZ_ROAD: dict[str, Any] = {
    "lanes_count": 3,
    "action": {"type": "DiscreteMetaAction", "target_speeds": list(range(0, 45, 5))},
    "reward_speed_range": [0, 40],
}
_ABZ_BASE = {**_ABZ_ROAD, "high_speed_reward": 1.0, "collision_reward": -1.0}

# Two notes on this reward:
# - `lane_change_reward` belongs to the case study's configuration and is kept for the record. highway-env 1.12 does not
#   read it in `HighwayEnv._rewards`, so it has no effect on this road.
# - A crash adds +1 and ends the episode. Without normalisation every further second would be worth up to +2.1, and a
#   crash would cost that whole future, so it would not be rewarded on balance. highway-env's normalisation maps
#   [collision_reward, high_speed_reward + right_lane_reward] = [1, 2.1] to [0, 1]. So a second on the left lane is
# worth (2 v / 40 - 1) / 1.1: nothing at v = 20 m/s, a loss below, little at the speed of the traffic. A crash adds 1 /
# 1.1 and ends the losses. So `normalize_reward` stays True here. With a discount of 0.9 a crash pays best only below
# about 22 m/s. Above that speed the agent drives fast through the traffic, without regard to a crash.
_ABZ_ADVERSARIAL = {
    **_ABZ_ROAD,
    "high_speed_reward": 2.0,
    "collision_reward": 1.0,
    "lane_change_reward": 0.5,
    "normalize_reward": True,
}

# Everything else is highway-v0's default, with its reward, which suits throttle and steering. It pays for the speed
# along the road, a crash costs 1 / 1.5 of the largest reward of a decision, and off the road the reward is 0. Only
# `offroad_terminal` differs: without it a car that has left the road continues with rewards of 0.
_CONTINUOUS: dict[str, Any] = {
    "action": {"type": "ContinuousAction"},
    "simulation_frequency": 20,
    "policy_frequency": 10,
    "duration": 40,
    "offroad_terminal": True,
}

# Decisions last twice as long and there are fewer vehicles, so a second of driving takes a tenth of the computing time.
# The reward differs: with normalisation a vehicle at rest receives 0.67 of 1 in every decision, and PPO learned to stop
# within 40,000 steps. Here it receives 0, and speed pays from 10 m/s on.
_CONTINUOUS_TRAINING: dict[str, Any] = {
    **_CONTINUOUS,
    "simulation_frequency": 10,
    "policy_frequency": 5,
    "vehicles_count": 12,
    "normalize_reward": False,
    "reward_speed_range": [10, 30],
}

# The configuration that HanoiWorld (2026) reports: decisions at 5 Hz, frames at 15 Hz.
_HANOI: dict[str, Any] = {"simulation_frequency": 15, "policy_frequency": 5, "collision_reward": -5}

SETTINGS: Mapping[str, Setting] = MappingProxyType(
    {
        setting.name: setting
        for setting in (
            Setting("highway-fast", "highway-fast-v0", {}, "highway-fast-v0 as it comes: 5 Hz"),
            Setting(
                "highway-fast-seen",
                "highway-fast-v0",
                {"observation": {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}},
                "highway-fast, of which 15 vehicles are observed, those behind too",
            ),
            Setting("highway", "highway-v0", {}, "highway-v0 as it comes: 15 Hz"),
            Setting(
                "highway-trucks",
                "highway-fast-v0",
                {"simulation_frequency": 15, "other_vehicles_type": TRAFFIC["trucks"]},
                "highway-fast-v0 among cars and trucks of 12 m, every third vehicle: 15 Hz",
            ),
            Setting(
                "abz",
                "highway-fast-v0",
                _ABZ_BASE,
                "ABZ 2025, training: 3 lanes, target speeds 0 to 40 m/s, crash reward -1, 5 Hz",
            ),
            Setting(
                "abz-adversarial",
                "highway-fast-v0",
                _ABZ_ADVERSARIAL,
                "ABZ 2025, training of an agent that is paid for crashing: crash reward +1, 5 Hz",
            ),
            Setting(
                "abz-idm",
                "highway-fast-v0",
                {**_ABZ_BASE, "simulation_frequency": 15, "other_vehicles_type": TRAFFIC["idm"]},
                "ABZ 2025, test: IDM traffic at 15 Hz, the reward of abz",
            ),
            Setting(
                "abz-aggressive",
                "highway-fast-v0",
                {
                    **_ABZ_BASE,
                    "simulation_frequency": 15,
                    "other_vehicles_type": TRAFFIC["aggressive"],
                },
                "ABZ 2025, test: aggressive traffic at 15 Hz, the reward of abz",
            ),
            Setting(
                "highway-continuous",
                "highway-v0",
                _CONTINUOUS,
                "highway-v0 with throttle and steering: decisions at 10 Hz, 20 Hz, 40 s, ends off the road",
            ),
            Setting(
                "highway-fast-continuous",
                "highway-fast-v0",
                {"action": {"type": "ContinuousAction"}, "policy_frequency": 5, "offroad_terminal": True},
                "highway-fast-v0 with throttle and steering, 5 Hz: returns are 5 times those of highway-fast",
            ),
            Setting(
                "highway-continuous-training",
                "highway-fast-v0",
                {**_CONTINUOUS_TRAINING, "lanes_count": 4},
                "highway-continuous, training: decisions at 5 Hz, 10 Hz, 12 other vehicles, nothing for standing",
            ),
            Setting("parking", "parking-v0", {}, "parking-v0 as it comes: an empty lot, 5 Hz, 100 s"),
            Setting(
                "parking-parked",
                "parking-v0",
                {"vehicles_count": 10},
                "parking-v0 with 10 parked vehicles (parking-parked-v0): the observation does not show them",
            ),
            Setting(
                "roundabout",
                "roundabout-v0",
                {},
                "roundabout-v0 as it comes: meta-actions at 1 Hz, target speeds 0, 8 and 16 m/s, 15 Hz, 11 s",
            ),
            Setting("merge", "merge-v0", {}, "merge-v0 as it comes: meta-actions at 1 Hz, 15 Hz, to 370 m"),
            Setting(
                "intersection",
                "intersection-v0",
                {},
                "intersection-v0 as it comes: slower, idle, faster at 1 Hz, targets 0, 4.5 and 9 m/s, 15 Hz, 13 s",
            ),
            Setting("exit", "exit-v0", {}, "exit-v0 as it comes: meta-actions at 1 Hz, 5 Hz, 18 s"),
            Setting("two-way", "two-way-v0", {}, "two-way-v0 as it comes: meta-actions at 1 Hz, 15 Hz"),
            Setting("u-turn", "u-turn-v0", {}, "u-turn-v0 as it comes: meta-actions at 1 Hz, 15 Hz, 10 s"),
            *(
                Setting(
                    f"{road}-continuous",
                    f"evaluation.wrappers:{road}-continuous-v{version}",
                    {},
                    f"{road}-v{version} with throttle and steering",
                    road=False,
                )
                for road, version in (("merge", 1), ("roundabout", 1), ("two-way", 0), ("u-turn", 1))
            ),
            Setting(
                "exit-continuous",
                "exit-v1",
                {"action": {"type": "ContinuousAction"}},
                "exit-v1 with throttle and steering",
                road=False,
            ),
            Setting(
                "intersection-continuous",
                "intersection-v1",
                {},
                "intersection-v1 as it comes: throttle and steering at 1 Hz, tyres that slip, 13 s",
                road=False,
            ),
            Setting(
                "hanoi-highway",
                "highway-v0",
                {
                    **_HANOI,
                    "action": {"type": "ContinuousAction"},
                    "lanes_count": 4,
                    "vehicles_count": 50,
                    "vehicles_density": 1.5,
                    "duration": 40,
                },
                "HanoiWorld's highway: throttle and steering at 5 Hz, 15 Hz, 50 vehicles at density 1.5, 40 s",
            ),
            Setting(
                "hanoi-merge",
                "merge-v0",
                {**_HANOI, "duration": 50},
                "HanoiWorld's merge: meta-actions at 5 Hz, 15 Hz",
            ),
            Setting(
                "hanoi-roundabout",
                "roundabout-v0",
                {**_HANOI, "duration": 15},
                "HanoiWorld's roundabout: meta-actions at 5 Hz, 15 Hz, 15 s",
            ),
            Setting(
                "complex-roads",
                "evaluation.scenarios:ComplexRoads-v0",
                {"random_start": True, "offroad_terminal": True, "duration": 120},
                "ComplexRoads-v0: 5x9 throttle and steering at 5 Hz, 15 Hz, any spawn, ends off the road, 120 s",
                road=False,
            ),
            Setting("racetrack", "racetrack-v0", {}, "racetrack-v0 as it comes: steering alone, 5 Hz, 15 Hz, 300 s"),
            Setting("racetrack-minute", "racetrack-v0", {"duration": 60}, "the first 60 s of racetrack-v0"),
            Setting(
                "lane-keeping",
                "evaluation.scenarios:lane-keeping-half-minute-v0",
                {},
                "30 s of lane-keeping-v0: steering alone, tyres that slip, no other vehicle, 10 Hz",
                road=False,
            ),
        )
    }
)
"""The named settings."""
