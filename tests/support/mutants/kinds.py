"""The definition of a mutant, and the files and tests that mutants name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mutants.nodes import path_of, replaced


@dataclass(frozen=True)
class Edit:
    """A change of one syntax node of one module.

    Attributes
    ----------
    module : dotted name. function : qualified name of the definition that the node is in.
    pattern : of the node, see `mutants.nodes`.
    new : what takes its place, see `mutants.nodes.replaced`. "pass" removes a statement.
    which : the number of the node among those of this pattern in the function, from 1 on; 0 where there is one.
    reads : a part of the node's source, where the pattern does not tell it from its like.
    """

    module: str
    function: str
    pattern: str
    new: str
    which: int = 0
    reads: str = ""

    def apply(self, root: Path) -> tuple[Path, str]:
        """The file of the module below a folder, and its source after the change.

        Raises
        ------
        StaleEditError
            If the node is not there, or not the only one.
        """
        path = path_of(self.module, root)
        source = path.read_text(encoding="utf-8")
        return path, replaced(source, self.function, self.pattern, self.new, self.which, self.reads)


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


VERIFY, CLAUSES = "shield.certificate.road.verify", "shield.certificate.road.clauses"
SEPARATION, ROOM, EDGE = f"{CLAUSES}.separation", f"{CLAUSES}.stopping_room", f"{CLAUSES}.edge"
DUTIES, ENTERING, SLIPS = f"{CLAUSES}.followers", f"{CLAUSES}.entering", f"{CLAUSES}.cut_in"
TOGETHER, SETTINGS = f"{CLAUSES}.all_clauses", f"{CLAUSES}.parameters"
MONITOR, MEMORY = "shield.certificate.road.monitor", "shield.certificate.road.memory"
MOBIL = "dynamics.traffic.mobil"
DECIDE, FRAMES = "shield.pipelines.decide", "shield.pipelines.frames"
INPUTS, LOT = "shield.pipelines.inputs", "shield.pipelines.parking_lot"
SEARCH, RULE_KERNELS = "shield.alternatives.nearest_input", "shield.rule_kernels"
MANOEUVRES = "shield.certificate.road.manoeuvres"
BODIES, REACTION = "dynamics.traffic.occupancy_kernels", "dynamics.traffic.reaction"
BATCH, EXACT = "shield.batch", "shield.certificate.simulated"
PERMITS, GAPS, ROLLOUTS = (
    "dynamics.traffic.rules_of_the_road",
    "dynamics.roads.gaps",
    "dynamics.vehicle.rollout_kernels",
)

TESTS_OF_CLAUSES = {
    "shield/certificate/road/clauses/test_all_clauses.py": {
        "pipeline": "test_no_verified_decision_has_a_negative_margin",
        "mended": "test_a_plan_that_nearly_verifies_does_not_displace_one_that_does",
        "first": "test_the_first_verified_plan_is_taken_or_else_the_largest_margin",
        "lanes": "test_an_input_passes_if_its_fail_safe_stops_in_any_lane",
        "bicycle": "test_the_fail_safe_of_inputs_is_the_motion_of_the_bicycle",
    },
    "shield/pipelines/test_evasion.py": {
        "evades": "test_every_candidate_evasion_clears_all_other_vehicles",
        "stops": "test_no_evasion_of_a_stopping_leader_blocks_the_vehicle_beside",
    },
    "shield/certificate/road/clauses/test_stopping_room.py": {
        "room": "test_a_plan_ends_inside_its_lane",
    },
    "shield/certificate/road/clauses/test_edge.py": {
        "road": "test_no_plan_leaves_the_road_or_reverses",
        "verdict": "test_the_verdict_of_inputs",
        "gap": "test_no_plan_crosses_a_gap_of_the_map",
    },
    "shield/certificate/road/test_monitor.py": {
        "alarm": "test_a_violation_is_counted_and_the_stored_plan_outlives_it",
        "forgiven": "test_violations_are_cleared_once_a_plan_clears_all_vehicles",
        "twice": "test_a_scene_observed_twice_counts_as_one_frame",
        "margin": "test_a_stored_plan_is_recorded_with_its_own_margin",
        "grown": "test_a_vehicle_that_takes_more_room_is_a_violator_if_the_fail_safe_needs_it",
        "comes beside": "test_a_follower_that_owes_distance_does_not_come_beside_the_ego",
    },
    "shield/certificate/road/clauses/test_separation.py": {
        "leader": "test_a_leader_that_brakes_and_turns_within_its_limits_is_not_touched",
        "buffer": "test_the_buffer_is_kept_along_and_across_the_road",
        "queue": "test_a_vehicle_that_stands_in_a_queue_may_reverse",
        "midline": "test_a_body_beyond_the_lane_marking_may_return",
        "coming": "test_the_next_frame_at_constant_velocity_is_clear_too",
    },
    "dynamics/traffic/test_occupancy_bounds.py": {
        "brakes": "test_the_rear_bound_is_that_of_a_braking_vehicle",
        "last": "test_the_last_frame_of_the_bound_holds_for_all_later_frames",
        "drift": "test_a_body_reaches_as_far_as_its_heading_leads",
        "diagonal": "test_a_turned_body_extends_along_the_road_by_its_diagonal",
    },
    "shield/certificate/road/clauses/test_entering.py": {
        "blind": "test_a_vehicle_beyond_the_entered_lane_may_enter_it_too",
        "loses": "test_a_vehicle_that_loses_by_a_lane_change_does_not_enter",
        "joins": "test_no_entrant_is_added_once_a_plan_stops_in_the_lane",
        "turning": "test_a_vehicle_that_is_changing_lanes_may_enter_until_the_ego_has_been_visible_long_enough",
        "anybody": "test_any_vehicle_may_enter_a_lane_from_which_the_ego_is_not_visible",
    },
    "shield/certificate/road/clauses/test_followers.py": {
        "follower": "test_a_follower_that_accelerates_until_its_reaction_time_ends_does_not_touch",
        "owes": "test_a_follower_owes_its_distance_in_the_lane_of_the_ego_only",
        "left": "test_no_follower_owes_distance_in_a_lane_that_the_ego_left_and_entered_again",
        "lasts": "test_a_follower_owes_its_distance_until_the_ego_has_left_its_strip",
        "corner": "test_a_follower_is_behind_until_it_touches_the_buffer",
        "owned": "test_a_lane_is_owned_only_with_a_verified_plan_and_while_the_ego_touches_it",
    },
    "shield/certificate/road/clauses/test_cut_in.py": {
        "slip": "test_a_vehicle_alongside_may_cut_in_behind_a_passing_ego",
    },
    "shield/pipelines/test_parking_lot.py": {
        "lot": "test_nothing_verifies_in_a_parking_lot_within_the_clearance",
    },
}
"""Short names of the tests of single clauses, by file in `tests`."""
TESTS = {short: f"tests/{file}::{test}" for file, tests in TESTS_OF_CLAUSES.items() for short, test in tests.items()}


def at(*names: str) -> tuple[str, ...]:
    """Targets: of the tests of single clauses the short name, "pipeline[frame]" with what they are given."""
    found = []
    for name in names:
        short, bracket, case = name.partition("[")
        found.append(f"{TESTS[short]}{bracket}{case}" if short in TESTS else name)
    return tuple(found)


def off(
    name: str, module: str, function: str, pattern: str, new: str, *tests: str, which: int = 0, reads: str = ""
) -> Mutant:
    """A mutant of one edit; `tests` as of `at`."""
    return Mutant(name, (Edit(module, function, pattern, new, which, reads),), at(*tests))


def both(name: str, *edits: Edit, tests: tuple[str, ...]) -> Mutant:
    return Mutant(name, edits, at(*tests))


TESTS_OF_PERMITS = "tests/dynamics/traffic/test_rules_of_the_road.py"
TESTS_OF_MOBIL = "tests/dynamics/traffic/test_mobil.py"
TESTS_OF_REACTION = "tests/dynamics/traffic/test_reaction.py"
TESTS_OF_LOT = "tests/shield/pipelines/test_parking_lot.py"


def verified(kind: str, test: str) -> Mutant:
    """There is one place where plans are accepted; what decides about each kind of action has to notice by itself."""
    return off(f"{kind} accepted at -0.3 m", DECIDE, "Plan.verified", "_ >= 0", "{1} >= -0.3", test)
