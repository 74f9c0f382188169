"""Entry points: `Shield(policy)` and `ShieldedEnv(env)`."""
