"""The clauses of the certificate, each with the change that switches it off and the tests that have to notice.

`mutation_check.py` (`make mutants`) applies them one at a time; `tests/test_mutants.py` checks that they still apply.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MUTANTS", "Edit", "Mutant"]


@dataclass(frozen=True)
class Edit:
    """A change of one file: `old` occurs in it exactly `count` times, and becomes `new` everywhere."""

    file: str
    old: str
    new: str
    count: int = 1


@dataclass(frozen=True)
class Mutant:
    """A clause switched off, a threshold loosened or a duty shortened.

    Attributes
    ----------
    name : what is off.
    edits : the changes that do it.
    tests : pytest targets of which at least one has to fail.
    """

    name: str
    edits: tuple[Edit, ...]
    tests: tuple[str, ...]


VERIFY, CLAUSES = "shield/certificate/verify.py", "shield/certificate/clauses"
SEPARATION, ROOM, EDGE = f"{CLAUSES}/separation.py", f"{CLAUSES}/room.py", f"{CLAUSES}/edge.py"
DUTIES, ENTERING, SLIPS = f"{CLAUSES}/duties.py", f"{CLAUSES}/entering.py", f"{CLAUSES}/slip_in.py"
TOGETHER, SETTINGS = f"{CLAUSES}/together.py", f"{CLAUSES}/settings.py"
MONITOR, MEMORY = "shield/certificate/monitor.py", "shield/certificate/memory.py"
MOBIL = "dynamics/traffic/mobil.py"
DECIDE, FRAMES = "shield/procedures/decide.py", "shield/procedures/frames.py"
INPUTS, LOT = "shield/procedures/inputs.py", "shield/procedures/parking_lot.py"
SEARCH, RULES, MANOEUVRES = "shield/repair/nearest_input.py", "shield/rules.py", "shield/certificate/manoeuvres.py"
BODIES, REACTION = "dynamics/traffic/occupancy_kernels.py", "dynamics/traffic/reaction.py"
PERMITS, GAPS, ROLLOUTS = "dynamics/traffic/permits.py", "dynamics/roads/gaps.py", "dynamics/vehicle/rollout_kernels.py"

_CLAUSES, _TRAFFIC = "tests/shield/test_clauses.py", "tests/shield/test_clauses_of_traffic.py"
_TESTS = {
    "door": "test_nothing_verified_has_a_negative_margin",
    "evades": "test_what_evades_an_offender_clears_everybody_else",
    "mended": "test_what_nearly_verifies_does_not_stand_in_the_way_of_what_does",
    "first": "test_the_first_that_verifies_is_taken_and_else_the_best",
    "lanes": "test_an_input_passes_in_whichever_lane_its_fail_safe_stops",
    "lot": "test_nothing_is_verified_in_a_parking_lot_without_the_clearance",
    "room": "test_a_plan_ends_inside_its_lane",
    "road": "test_nothing_leads_off_the_road_or_backwards",
    "verdict": "test_the_verdict_of_inputs",
    "gap": "test_nothing_leads_through_a_gap_of_the_map",
    "alarm": "test_a_violation_is_counted_and_the_stored_plan_outlives_it",
    "margin": "test_a_stored_plan_is_recorded_with_its_own_margin",
    "forgiven": "test_who_has_broken_a_rule_is_forgiven_once_a_plan_clears_everybody_again",
    "twice": "test_one_instant_seen_twice_is_one",
    "comes beside": "test_who_owes_the_ego_its_distance_does_not_come_beside_it",
    "grown": "test_who_takes_more_room_has_to_leave_it_to_the_fail_safe",
}
_TESTS_OF_TRAFFIC = {
    "leader": "test_a_leader_that_brakes_and_turns_as_it_may_is_not_touched",
    "follower": "test_a_follower_that_pushes_until_it_owes_its_braking_does_not_touch",
    "brakes": "test_the_bound_along_the_road_is_that_of_one_that_brakes",
    "bicycle": "test_the_fail_safe_of_inputs_is_what_the_bicycle_does",
    "buffer": "test_the_buffer_is_kept_along_and_across",
    "queue": "test_one_that_stands_in_a_queue_may_reverse_into_the_ego",
    "midline": "test_a_body_beyond_the_midline_may_go_back",
    "drift": "test_a_body_counts_as_where_its_heading_leads",
    "diagonal": "test_a_turned_body_reaches_along_the_road_by_its_diagonal",
    "coming": "test_the_coming_frame_is_clear_too",
    "blind": "test_a_vehicle_beyond_the_lane_that_is_entered_may_enter_it_as_well",
    "loses": "test_who_loses_by_it_does_not_enter",
    "joins": "test_nobody_joins_those_who_may_enter_once_there_is_a_plan_to_stop_there",
    "turning": "test_one_that_is_on_its_way_may_still_come_until_the_ego_has_been_seen_for_long",
    "owes": "test_who_owes_the_ego_its_distance",
    "left": "test_nobody_owes_a_place_that_the_ego_has_left_and_comes_back_to",
    "lasts": "test_one_that_owes_the_ego_its_distance_does_so_until_the_ego_has_left_its_strip",
    "corner": "test_one_that_owes_the_ego_its_distance_is_behind_until_it_touches_the_buffer",
    "anybody": "test_anybody_may_come_into_a_lane_out_of_whose_sight_the_ego_has_got",
    "owned": "test_a_lane_is_owned_only_with_a_verified_plan_and_no_longer_than_it_is_touched",
    "slip": "test_one_alongside_may_slip_in_behind_an_ego_that_passes_it",
}


def _at(*names: str) -> tuple[str, ...]:
    """Targets: of the tests of single clauses the short name, "door[frame]" with what they are given."""
    found = []
    for name in names:
        short, bracket, case = name.partition("[")
        for file, tests in ((_CLAUSES, _TESTS), (_TRAFFIC, _TESTS_OF_TRAFFIC)):
            name = f"{file}::{tests[short]}{bracket}{case}" if short in tests else name
        found.append(name)
    return tuple(found)


def _off(name: str, file: str, old: str, new: str, *tests: str, count: int = 1) -> Mutant:
    return Mutant(name, (Edit(file, old, new, count),), _at(*tests))


def _both(name: str, *edits: Edit, tests: tuple[str, ...]) -> Mutant:
    return Mutant(name, edits, _at(*tests))


_PERMITS, _MOBIL = "tests/dynamics/test_permits.py", "tests/dynamics/test_mobil.py"
_REACTION = "tests/dynamics/test_reaction.py"
_LOT = "tests/shield/test_lot.py"


def _verified(kind: str, test: str) -> Mutant:
    """There is one place where plans are accepted; what decides about each kind of action has to notice by itself."""
    old = "        return self.trusted or self.margin >= 0\n"
    return _off(f"{kind} accepted at -0.3 m", DECIDE, old, old.replace(">= 0", ">= -0.3"), test)


_ACCEPTED = (
    _verified("frame", "door[frame]"),
    _verified("lane change", "door[lane change]"),
    _verified("FASTER", "door[faster]"),
    _verified("SLOWER", "door[slower]"),
    _verified("mask", "door[mask]"),
    _verified("lane change without frames", "door[held lane change]"),
    _verified("FASTER without frames", "door[held faster]"),
    _verified("throttle", "door[throttle]"),
    _verified("throttle and wheel", "door[throttle and wheel]"),
    _verified("parking", "lot"),
    _off(
        "fail-safe of a frame chosen at -0.3 m",
        FRAMES,
        "        if margin >= 0:",
        "        if margin >= -0.3:",
        "first",
    ),
    _off(
        "frame held back to -0.3 m",
        FRAMES,
        "np.where(result.margin >= 0, accelerations",
        "np.where(result.margin >= -0.3, accelerations",
        "mended[frame]",
    ),
    _off(
        "frame to evade with chosen at -0.3 m",
        FRAMES,
        "    keeps = lawful >= 0\n",
        "    keeps = lawful >= -0.3\n",
        "evades[ShieldCore]",
    ),
    _both(
        "frame evades at -0.3 m",
        Edit(FRAMES, "    keeps = lawful >= 0\n", "    keeps = lawful >= -0.3\n"),
        Edit(FRAMES, "                if lawful >= 0:", "                if lawful >= -0.3:"),
        tests=("evades[ShieldCore]",),
    ),
    _off(
        "fail-safe of an input chosen at -0.3 m",
        INPUTS,
        "        good = each >= 0\n",
        "        good = each >= -0.3\n",
        "lanes",
    ),
    _off(
        "no other fail-safe of an input above -0.3 m",
        INPUTS,
        "if not judged.margin[0] >= 0 and others:",
        "if not judged.margin[0] >= -0.3 and others:",
        "lanes",
    ),
    _off(
        "input repaired to -0.3 m",
        SEARCH,
        "judged.margin >= 0",
        "judged.margin >= -0.3",
        "mended[throttle]",
        count=6,
    ),
    _off(
        "input evades at -0.3 m",
        INPUTS,
        "np.flatnonzero(lawful.margin >= 0)",
        "np.flatnonzero(lawful.margin >= -0.3)",
        "evades[ContinuousCore]",
    ),
    _off(
        "parking repaired near the proposal to -0.05 m",
        LOT,
        "if judged.margin[0] >= 0 else np.inf",
        "if judged.margin[0] >= -0.05 else np.inf",
        _LOT,
    ),
    _off(
        "parking repaired far from the proposal to -0.05 m",
        LOT,
        "np.where(grid.margin >= 0,",
        "np.where(grid.margin >= -0.05,",
        _LOT,
    ),
)

_CLEARANCE = (
    _off(
        "separation off",
        ROOM,
        "            least = min(least, separations[i, j])",
        "            least = min(least, np.inf)",
        "leader",
    ),
    _off("room in the lane off", ROOM, "        if room[i] < 0:", "        if room[i] < -1e9:", "room"),
    _off(
        "road edge off",
        EDGE,
        "margin[i] if room >= 0 else min(margin[i], room)",
        "margin[i] if room >= -1e9 else min(margin[i], room)",
        "road",
        "verdict",
    ),
    _off("one new lane at most, and none again, off", EDGE, "if not allowed[i] or paths", "if paths", "verdict"),
    _off("rolling backwards off", EDGE, "paths[i, held - 1, 3] < -1e-9", "paths[i, held - 1, 3] < -1e9", "road"),
    _off(
        "both sides at once off",
        EDGE,
        "        if count > 1:",
        "        if count > 9:",
        "tests/shield/test_kernels.py",
    ),
    _off(
        "no way back to a lane left off",
        EDGE,
        "if k > 0 and owned[j] and inside",
        "if k < 0 and owned[j] and inside",
        "tests/shield/test_kernels.py",
    ),
    _off("gaps of the map off", VERIFY, "        if gaps is not None:", "        if gaps is None and gaps:", "gap"),
    _off(
        "gap beginning within a stretch off",
        GAPS,
        "        low = np.minimum(low, np.minimum(low[before], low[after]))",
        "        low = low + 0.05",
        "tests/dynamics/test_gaps.py",
    ),
    _off(
        "slip-in off",
        TOGETHER,
        "    slips = slipping if hold == 0",
        "    slips = slipping if hold < 0",
        "slip",
    ),
    _off(
        "slip-in counts for nothing",
        ROOM,
        "            least = min(least, slipping[i, j])",
        "            least = min(least, np.inf)",
        "slip",
    ),
    _off(
        "one that slips in keeps its speed meanwhile",
        SLIPS,
        "slows = min(COMFORT * slips.ratios[1, j] ** 2, slips.braking)",
        "slows = 0.0",
        "tests/shield/test_alongside.py",
    ),
    _off(
        "coming frame off",
        SEPARATION,
        "    return apart if apart < 0 else np.inf",
        "    return np.inf",
        "coming[0]",
    ),
    _off("later coming frames off", SEPARATION, "if later < 0:", "if later < -1e9:", "coming[1]"),
    _off(
        "buffer rule off",
        RULES,
        "        return bool(beside.any())",
        "        return False",
        "tests/shield/test_rules.py",
    ),
    _off("buffer along off", VERIFY, "0.5 * length + buffer.longitudinal,", "0.5 * length,", "buffer"),
    _off(
        "buffer across off",
        VERIFY,
        "0.5 * width + buffer.lateral\n    size",
        "0.5 * width\n    size",
        "buffer",
    ),
)

_OWED = (
    _off(
        "blind merge off",
        TOGETHER,
        "x.blind > 0 and hold == 0",
        "False",
        "blind",
    ),
    _off(
        "nobody enters but who is on the way",
        ENTERING,
        "may[k, j] = turning[k, j] or gains[j, 1 if above else 0]",
        "may[k, j] = turning[k, j]",
        "blind",
    ),
    _off(
        "nobody enters but who gains by it",
        ENTERING,
        "may[k, j] = turning[k, j] or gains[j, 1 if above else 0]",
        "may[k, j] = gains[j, 1 if above else 0]",
        "loses",
    ),
    _off(
        "seen at once by one that is turning in", ENTERING, "if visible[k] >= settled:", "if visible[k] > 0:", "turning"
    ),
    _off("who turns in gives way", ENTERING, "before[k, j] and turning[k, j]", "False", "turning"),
    _off(
        "begun before it could see the ego",
        ENTERING,
        "elif visible[k] > sight:",
        "elif visible[k] > 0:",
        "tests/shield/test_kernels.py",
    ),
    _off(
        "nobody comes where the ego is out of sight",
        ENTERING,
        "leaves and beside",
        "False and beside",
        "joins",
    ),
    _off(
        "everybody behind owes",
        DUTIES,
        "behind[j] and held[j] and not entered",
        "behind[j] and not entered",
        "owes",
    ),
    _off(
        "owed even where the path enters the lane",
        DUTIES,
        "behind[j] and held[j] and not entered",
        "behind[j] and held[j]",
        "owes",
    ),
    _off(
        "those ahead owe",
        DUTIES,
        "behind[j] and held[j] and not entered",
        "held[j] and not entered",
        "owes",
    ),
    _off(
        "owed what was left and is come back to",
        DUTIES,
        "        if inside and left:",
        "        if inside and False:",
        "left",
    ),
    _off(
        "duty ends where the lane is owned no more",
        DUTIES,
        "held or (followed and low",
        "held or (False and low",
        "lasts",
    ),
    _off(
        "duty ends where a corner comes beside a corner",
        DUTIES,
        "behind = gap_between(ego.seen, ego.seen.along, ego.seen.across, rows, j, 0.0) >= 0",
        "pass",
        "corner",
    ),
    _off(
        "duty lasts where the buffer is touched",
        DUTIES,
        "behind = gap_between(ego.seen, ego.seen.along, ego.seen.across, rows, j, 0.0) >= 0",
        "behind = True",
        "corner",
    ),
    _off(
        "nobody joins where the ego has got out of sight",
        DUTIES,
        "            comes[j, :] = True",
        "            pass",
        "anybody",
    ),
    _off("who enters need not gain by it", MOBIL, "gain >= _LEAST_GAIN - slack and imposed", "imposed", _MOBIL),
    _off("who enters may impose anything", MOBIL, " and imposed <= IMPOSED + slack", "", _MOBIL),
    _off("lane owned without a plan", DUTIES, "(had or j == stored) and offset < touch", "offset < touch", "owned"),
    _off("lane owned for ever", DUTIES, "(had or j == stored) and offset < touch", "had or j == stored", "owned"),
    _off(
        "reaction time off",
        SEPARATION,
        "else first + reaction",
        "else first",
        "follower[idm-15-20-0.0]",
        "follower[rss-25-20-0.0]",
    ),
    _off(
        "visible from the first frame on",
        SEPARATION,
        "            first = k + 2\n",
        "            first = 1\n",
        "follower[idm-15-20-0.0]",
    ),
    _off(
        "seen for long already",
        TOGETHER,
        "np.full(home.shape, -1)",
        "np.full(home.shape, 0)",
        "follower[idm-15-20-1.5]",
        "follower[rss-25-20-1.5]",
    ),
    _off(
        "follower that still brakes when the ego stands off",
        SEPARATION,
        "    if paths[i, frames - 1, 3] < 0.5:",
        "    if paths[i, frames - 1, 3] < -0.5:",
        "follower[rss-25-20-0.0]",
        "follower[idm-15-20-0.0]",
    ),
    _off(
        "follower accelerates half as hard",
        SEPARATION,
        "min(gain, power / max(speed, 1e-3)) * dt, top)",
        "0.5 * min(gain, power / max(speed, 1e-3)) * dt, top)",
        "follower[idm-15-20-0.0]",
    ),
    _off(
        "follower brakes harder than it owes",
        SETTINGS,
        "            a.follower_braking,",
        "            1.25 * a.follower_braking,",
        "follower[idm-15-20-0.0]",
    ),
)

_PLACES = (
    _off(
        "old lane dropped at the midline",
        BODIES,
        "        lane[i], starts[i], ends[i] = here, first, last",
        "        lane[i], starts[i], ends[i] = here, here, here\n        first, last = here, here",
        "midline",
    ),
    _off("wavering off", BODIES, "0.5 * width + lanes.waver", "0.5 * width", _PERMITS),
    _off("leaning off", BODIES, "0.5 * lanes.width + lanes.lean, 0.5", "0.5 * lanes.width, 0.5", _PERMITS),
    _off("drift along the heading off", BODIES, "drift = v * sin * lanes.dt", "drift = 0.0 * sin", "drift"),
    _off(
        "reach is half the length only",
        BODIES,
        "0.5 * math.hypot(length, width) + along",
        "0.5 * length + along",
        "diagonal",
    ),
    _off(
        "turning costs nothing",
        BODIES,
        "    return min(budget, action / max(slow, motion.slow))",
        "    return 0.0 * budget",
        "leader",
    ),
    _off(
        "reversing in a queue off",
        BODIES,
        "        if motion.reversing > 0 and not wrecked:",
        "        if motion.reversing < 0 and not wrecked:",
        "queue",
    ),
    _off(
        "least place of the last frame off",
        BODIES,
        "        if hold == 0 and frames > 0:",
        "        if hold == 0 and frames < 0:",
        "queue",
    ),
    _off("others brake less hard", BODIES, "speed -= _rate(", "speed -= 0.8 * _rate(", "brakes"),
    _off(
        "others stop less soon",
        BODIES,
        "speed - _rate(",
        "speed - 0.8 * _rate(",
        "brakes",
    ),
    _off(
        "others accelerate less hard",
        BODIES,
        "v + min(motion.acceleration, motion.power",
        "v + 0.8 * min(motion.acceleration, motion.power",
        _PERMITS,
    ),
    _off(
        "fail-safe assumed to brake harder",
        ROLLOUTS,
        "goal, a = centers[fails[i]], -braking",
        "goal, a = centers[fails[i]], -1.2 * braking",
        "leader",
    ),
    _off(
        "fail-safe of inputs assumed to brake harder",
        ROLLOUTS,
        "            a = max(-braking, max(v, 0.0) * (-1 / dt))",
        "            a = max(-1.2 * braking, max(v, 0.0) * (-1 / dt))",
        "bicycle",
    ),
)

_WATCHED = (
    _off(
        "monitor never reports",
        MONITOR,
        "        before = self.before(scene)\n        crashed",
        "        before = None\n        crashed",
        "alarm",
    ),
    _off(
        "whoever owes the ego its distance may come beside it",
        MONITOR,
        "            grown[i] |= _DISTANCE",
        "            pass",
        "comes beside",
    ),
    _off(
        "nobody is forgiven",
        DECIDE,
        "memory.watch.forgiven() if tier.verified else memory.watch",
        "memory.watch",
        "forgiven[ShieldCore]",
        "forgiven[ContinuousCore]",
    ),
    _off(
        "forgiven without a plan that clears everybody",
        DECIDE,
        "memory.watch.forgiven() if tier.verified else memory.watch",
        "memory.watch.forgiven()",
        "alarm",
    ),
    _off(
        "an instant seen twice is two",
        MEMORY,
        "scene.frame is not None and scene.frame == memory.frame",
        "False",
        "twice",
    ),
    _off("more room is never too much", MONITOR, "        if more:", "        if False:", "grown"),
    _off("SPEED off", PERMITS, "                bits |= _SPEED", "                bits |= 0", _PERMITS),
    _off(
        "WAY off",
        PERMITS,
        "                if back or ahead or not abs(dr)",
        "                if False and not abs(dr)",
        _PERMITS,
    ),
    _off(
        "what turning may cost off",
        PERMITS,
        "if not min(budget[i], action[i]) >= -_SLIGHT:",
        "if False:",
        _PERMITS,
    ),
    _off(
        "a second of turning costs what it likes",
        BODIES,
        "        if within > swing * motion.burst:",
        "        if False:",
        _PERMITS,
    ),
    _off("BRAKING off", PERMITS, "                more |= _BRAKING", "                more |= 0", _PERMITS),
    _off(
        "one who brakes hard for nothing is not noticed",
        PERMITS,
        "harder = not v0 - v <= (allowed + _TOLERANCE) * limits.period / limits.frames",
        "harder = False",
        _PERMITS,
    ),
    _off(
        "one who may brake harder than before is not noticed",
        PERMITS,
        "harder = harder or brakes[i, k] > brakes0[i, k + frames] + _TOLERANCE",
        "harder = harder",
        _PERMITS,
    ),
    _off(
        "nobody ahead asks for braking",
        REACTION,
        "            brakes[k] = max(brakes[k], rate)",
        "            brakes[k] = motion.calm",
        _REACTION,
    ),
    _off(
        "nobody moves in ahead",
        REACTION,
        "        if not entered and k >= first:",
        "        if False:",
        _REACTION,
    ),
    _off(
        "the ego is braked for by nobody",
        REACTION,
        "if behind > 0 or others[i, _CRASHED] > 0:",
        "if others[i, _CRASHED] > 0:",
        _REACTION,
    ),
    _off("LANES off", PERMITS, "            more |= _LANES", "            more |= 0", _PERMITS),
    _off("REVERSING off", PERMITS, "            more |= _REVERSING", "            more |= 0", _PERMITS),
    _off("DISTANCE off", PERMITS, "            bits |= _DISTANCE", "            bits |= 0", _PERMITS),
    _off("CRASH off", PERMITS, "            bits |= _CRASH", "            bits |= 0", _PERMITS),
    _off(
        "stored plan of frames given up on an alarm",
        FRAMES,
        "(kept.margin >= -ROUNDING or not violated)",
        "not violated",
        "alarm[ShieldCore]",
    ),
    _both(
        "stored plan of inputs given up on an alarm",
        Edit(INPUTS, "keeps and violated", "False"),
        Edit(INPUTS, "keeps or not violated", "not violated"),
        tests=("alarm[ContinuousCore]",),
    ),
    _off(
        "stored plan of frames without its own margin",
        FRAMES,
        "Plan(command, kept.margin, kept.lane",
        "Plan(command, float('inf'), kept.lane",
        "margin[ShieldCore]",
    ),
    _off(
        "stored plan of inputs with the proposal's margin",
        INPUTS,
        "replace(self.plan(now, stored), action=law[0])",
        "replace(tried[0].plan, action=law[0])",
        "margin[ContinuousCore]",
    ),
    _off(
        "what does not verify is stored",
        DECIDE,
        "stored = None if tier is Tier.LARGEST_MARGIN else plan.stored",
        "stored = plan.stored",
        f"{_LOT}::test_without_a_plan_to_begin_with_the_record_says_so",
    ),
)

MUTANTS = (*_ACCEPTED, *_CLEARANCE, *_OWED, *_PLACES, *_WATCHED)
