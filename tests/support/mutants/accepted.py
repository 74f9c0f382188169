"""What is accepted short of the certificate."""

from __future__ import annotations

from mutants.kinds import DUTIES, FRAMES, INPUTS, LOT, SEARCH, TESTS_OF_LOT, Edit, both, off, verified

__all__ = ["ACCEPTED"]

ACCEPTED = (
    verified("frame", "door[frame]"),
    verified("lane change", "door[lane change]"),
    verified("FASTER", "door[faster]"),
    verified("SLOWER", "door[slower]"),
    verified("mask", "door[mask]"),
    verified("lane change without frames", "door[held lane change]"),
    verified("FASTER without frames", "door[held faster]"),
    verified("throttle", "door[throttle]"),
    verified("throttle and wheel", "door[throttle and wheel]"),
    verified("parking", "lot"),
    off(
        "fail-safe of a frame chosen at -0.3 m",
        FRAMES,
        "        if margin >= 0:",
        "        if margin >= -0.3:",
        "first",
    ),
    off(
        "a decision held back to what its frame does not try",
        "shield/procedures/meta_actions.py",
        "HoldBack(begins=True)",
        "HoldBack()",
        "tests/shield/test_first_frame.py",
    ),
    off(
        "a vehicle counted by its centre",
        DUTIES,
        "abs(ahead[j]) - size[j] <= perception",
        "abs(ahead[j]) <= perception",
        "tests/shield/test_unreadable_vehicles.py",
    ),
    off(
        "frame held back to -0.3 m",
        FRAMES,
        "np.where(result.margin >= 0, accelerations",
        "np.where(result.margin >= -0.3, accelerations",
        "mended[frame]",
    ),
    off(
        "frame to evade with chosen at -0.3 m",
        FRAMES,
        "    keeps = lawful >= 0\n",
        "    keeps = lawful >= -0.3\n",
        "stops",
    ),
    both(
        "frame evades at -0.3 m",
        Edit(FRAMES, "    keeps = lawful >= 0\n", "    keeps = lawful >= -0.3\n"),
        Edit(FRAMES, "                if lawful >= 0:", "                if lawful >= -0.3:"),
        tests=("stops",),
    ),
    off(
        "fail-safe of an input chosen at -0.3 m",
        INPUTS,
        "        good = each >= 0\n",
        "        good = each >= -0.3\n",
        "lanes",
    ),
    off(
        "no other fail-safe of an input above -0.3 m",
        INPUTS,
        "if not judged.margin[0] >= 0 and others:",
        "if not judged.margin[0] >= -0.3 and others:",
        "lanes",
    ),
    off(
        "input repaired to -0.3 m",
        SEARCH,
        "judged.margin >= 0",
        "judged.margin >= -0.3",
        "mended[throttle]",
        count=6,
    ),
    off(
        "a frame evades by the worst case",
        FRAMES,
        "lawful, expected = result.margin, result\n    if now.memory.watch.violated:\n",
        "lawful, expected = result.margin, result\n    if False:\n",
        "tests/shield/test_batch.py",
    ),
    off(
        "many frames evade by the worst case",
        "shield/batch/repairing.py",
        "plans.expected[i], plans.lasting[i] = plans.margins[i], plans.clear[i]",
        "plans.expected[i], plans.lasting[i] = plans.lawful[i], plans.clear[i]",
        "tests/shield/test_batch.py",
    ),
    off(
        "a frame evades without the worst case",
        "shield/certificate/verify.py",
        "margin, worst.clear, expected.clear))[-1]",
        "margin, expected.clear))[-1]",
        "tests/shield/test_batch.py",
    ),
    off(
        "many frames evade without the worst case",
        "shield/batch/repairing.py",
        "found = (plans.lasting[i], plans.clear[i], margin)",
        "found = (plans.lasting[i], 0, margin)",
        "tests/shield/test_batch.py",
    ),
    off(
        "input evades at -0.3 m",
        INPUTS,
        "np.flatnonzero(lawful.margin >= 0)",
        "np.flatnonzero(lawful.margin >= -0.3)",
        "evades[ContinuousCore-shield.procedures.inputs]",
    ),
    off(
        "parking repaired near the proposal to -0.05 m",
        LOT,
        "if judged.margin[0] >= 0 else np.inf",
        "if judged.margin[0] >= -0.05 else np.inf",
        TESTS_OF_LOT,
    ),
    off(
        "parking repaired far from the proposal to -0.05 m",
        LOT,
        "np.where(grid.margin >= 0,",
        "np.where(grid.margin >= -0.05,",
        TESTS_OF_LOT,
    ),
)
