"""How often highway-env's own traffic breaks the right of way where a shield counts on it.

Run `python benchmarks/right_of_way.py`; it takes a minute.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from evaluation.measuring.statistics import wilson
from evaluation.settings import setting_of
from shield import ShieldedEnv
from shield.certificate.network.monitor import NetworkRule
from shield.certificate.network.others import default_on
from shield.filters.network import NetworkFilter

EPISODES, FIRST, LONGEST = 25, 5_200, 40
ROADS = (("roundabout-v1", 3), ("merge-v1", 3), ("intersection-v2", 2))
"""Environment, and the number of FASTER."""


def main() -> None:
    """Drive always FASTER, and print the share of episodes with a breach."""
    for env_id, faster in ROADS:
        raw = setting_of(env_id).make()
        config = default_on(raw.unwrapped)
        env = ShieldedEnv(raw, config.replace(assumptions=replace(config.assumptions, gives_way=True)))
        network_filter, broken, rules = env.filter, 0, Counter[str]()
        assert isinstance(network_filter, NetworkFilter)
        for seed in range(FIRST, FIRST + EPISODES):
            env.reset(seed=seed)
            for _ in range(LONGEST):
                *_, terminated, truncated, _ = env.step(faster)
                if terminated or truncated:
                    break
            found = network_filter.watch.by_rule
            broken += NetworkRule.RIGHT_OF_WAY in found
            rules.update({str(rule): count for rule, count in found.items()})
        share = wilson(broken, EPISODES)
        print(f"{env_id}: {broken} of {EPISODES} episodes [{share.low:.0%}, {share.high:.0%}]; {dict(rules)}")


if __name__ == "__main__":
    main()
