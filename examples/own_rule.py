"""A rule of your own in the place of the certificate: nobody ahead may be reached in less than three seconds.

Takes 5 s on one core.
"""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from shield import Reason, ShieldedEnv
from shield.testing import check_rule


class ThreeSeconds:
    """Refuses whatever leads to a lane in which the next vehicle ahead is less than three seconds away."""

    reason = Reason.TTC

    def objects(self, scene, target):
        ahead = scene.others_road[:, 0] - scene.ego_road[0]
        in_lane = np.abs(scene.others_road[:, 1] - scene.road.centers[target.lane]) < scene.road.width / 2
        gap = ahead[in_lane & (ahead > 0)].min(initial=np.inf)
        return bool(gap < 3.0 * target.speed)


check_rule(ThreeSeconds())  # it changes nothing, and answers with true or false
env = ShieldedEnv(gym.make("highway-fast-v0"), rule=ThreeSeconds())
env.reset(seed=100_000)
done, refused = False, 0
while not done:
    *_, terminated, truncated, info = env.step(3)
    refused, done = refused + info["shield"]["overridden"], terminated or truncated
print(f"refused {refused} times; crashed: {env.unwrapped.vehicle.crashed}")
