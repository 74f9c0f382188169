"""PPO learns inside the shield where the highway is compiled: the same network, much sooner.

Without the shield, `evaluation.learning.fast_vec_env.FastHighwayVecEnv(8, "highway-fast-v0")` takes its place.
Takes 63 s on one core.
"""

import os
import time

from stable_baselines3 import PPO

from evaluation.learning.shielded_vec_env import ShieldedVecEnv
from shield import ShieldCallback, ShieldConfig

steps = int(os.environ.get("STEPS", "50000"))
world = ShieldedVecEnv(8, "highway-fast-v0", {"vehicles_count": 30}, shield=ShieldConfig())
model = PPO("MlpPolicy", world, n_steps=64, device="cpu", seed=0)

start = time.perf_counter()
model.learn(steps, callback=ShieldCallback())
print(f"{model.num_timesteps / (time.perf_counter() - start):.0f} decisions a second, learning included")
model.save("runs/trained-fast")
