"""Where users come in: `Shield(policy)` and `ShieldedEnv(env)`."""
