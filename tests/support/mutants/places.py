"""Where the others can be."""

from __future__ import annotations

from mutants.kinds import BODIES, ROLLOUTS, TESTS_OF_PERMITS, TOGETHER, off

__all__ = ["PLACES"]

PLACES = (
    off(
        "old lane dropped at the midline",
        BODIES,
        "        lane[i], starts[i], ends[i] = here, first, last",
        "        lane[i], starts[i], ends[i] = here, here, here\n        first, last = here, here",
        "midline",
    ),
    off("wavering off", BODIES, "0.5 * width + lanes.waver", "0.5 * width", TESTS_OF_PERMITS),
    off("leaning off", BODIES, "0.5 * lanes.width + lanes.lean, 0.5", "0.5 * lanes.width, 0.5", TESTS_OF_PERMITS),
    off("drift along the heading off", BODIES, "drift = v * sin * lanes.dt", "drift = 0.0 * sin", "drift"),
    off(
        "reach is half the length only",
        BODIES,
        "0.5 * math.hypot(length, width))",
        "0.5 * length)",
        "diagonal",
    ),
    off(
        "turning costs nothing",
        BODIES,
        "    return min(budget, action / max(slow, motion.slow))",
        "    return 0.0 * budget",
        "leader",
    ),
    off(
        "reversing in a queue off",
        BODIES,
        "        if motion.reversing > 0 and not wrecked:",
        "        if motion.reversing < 0 and not wrecked:",
        "queue",
    ),
    off(
        "least place of the last frame off",
        BODIES,
        "        if hold == 0 and frames > 0:",
        "        if hold == 0 and frames < 0:",
        "last",
    ),
    off(
        "least place of the last frame looked at off",
        TOGETHER,
        "        if last and hold == 0:",
        "        if last and hold > 0:",
        "queue",
    ),
    off("others brake less hard", BODIES, "speed -= rate * dt", "speed -= 0.8 * rate * dt", "brakes"),
    off(
        "others stop less soon",
        BODIES,
        "speed - rate * motion.dt",
        "speed - 0.8 * rate * motion.dt",
        "brakes",
    ),
    off(
        "others accelerate less hard",
        BODIES,
        "v + min(motion.acceleration, motion.power",
        "v + 0.8 * min(motion.acceleration, motion.power",
        TESTS_OF_PERMITS,
    ),
    off(
        "fail-safe assumed to brake harder",
        ROLLOUTS,
        "to, a = last_goal, -braking",
        "to, a = last_goal, -1.2 * braking",
        "leader",
    ),
    off(
        "fail-safe of inputs assumed to brake harder",
        ROLLOUTS,
        "            a = max(-braking, max(v, 0.0) * (-1 / dt))",
        "            a = max(-1.2 * braking, max(v, 0.0) * (-1 / dt))",
        "bicycle",
    ),
)
