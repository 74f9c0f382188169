"""Paired episodes with and without the shield, the summary with its intervals, and a plot of both returns.

Takes 22 s on one core.
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt

from evaluation.measuring.metrics import compare, summarise
from evaluation.running.episodes import run_paired
from evaluation.running.records import make_variants

EPISODES = int(os.environ.get("EPISODES", "50"))

variants = make_variants(["none", "full"], ["env"])
episodes = run_paired("highway-fast", "ppo-highway-fast", variants, range(100_000, 100_000 + EPISODES), jobs=-1)
print(summarise(episodes)[["mode", "crash_rate", "crash_rate_low", "crash_rate_high", "return", "override_rate"]])
print(compare(episodes)[["crashes_prevented", "crashes_added", "return_difference", "mcnemar_p"]])

table = episodes.pivot(index="seed", columns="mode", values="return")
table.plot.scatter(x="none", y="full", xlabel="return, bare", ylabel="return, shielded")
Path("runs").mkdir(exist_ok=True)
plt.savefig("runs/returns.png", dpi=150)
