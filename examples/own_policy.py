"""Any function of the observation is a policy, a network too; the shield says what it did and why.

Takes 5 s on one core.
"""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)

from shield import Shield

IDLE, FASTER = 1, 3


def eager(observation):
    """Faster and faster, but for a leader within 20 m (the observation is in units of 200 m)."""
    leader = observation[1]
    return IDLE if 0 < leader[1] < 0.1 and abs(leader[2]) < 0.1 else FASTER


env = gym.make("highway-fast-v0")
shield = Shield(eager, env=env)
obs, _ = env.reset(seed=100_000)
done = False
while not done:
    action, _ = shield.predict(obs)
    obs, _, terminated, truncated, _ = env.step(int(action))
    decision, done = shield.last_decision, terminated or truncated
    if decision.overridden:
        print(f"{decision.proposed} -> {decision.executed}, {decision.intervention}: {decision.reason.text}")
print(shield.report(), "crashed:", env.unwrapped.vehicle.crashed)
