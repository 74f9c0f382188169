"""What a mutant is, and where the files and the tests are that mutants name."""

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

TESTS_OF_CLAUSES = "tests/shield/certificate/road/clauses/test_judging.py"
TRAFFIC = "tests/shield/certificate/road/clauses/test_traffic.py"
TESTS = {
    "door": "test_nothing_verified_has_a_negative_margin",
    "evades": "test_whatever_evades_an_offender_clears_everybody_else",
    "stops": "test_nobody_evades_one_who_stops_into_the_way_of_another",
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
TESTS_OF_TRAFFIC = {
    "leader": "test_a_leader_that_brakes_and_turns_as_it_may_is_not_touched",
    "follower": "test_a_follower_that_pushes_until_it_owes_its_braking_does_not_touch",
    "brakes": "test_the_bound_along_the_road_is_that_of_one_that_brakes",
    "bicycle": "test_the_fail_safe_of_inputs_is_what_the_bicycle_does",
    "buffer": "test_the_buffer_is_kept_along_and_across",
    "last": "test_the_last_frame_that_is_looked_at_stands_for_all_that_follow",
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


def at(*names: str) -> tuple[str, ...]:
    """Targets: of the tests of single clauses the short name, "door[frame]" with what they are given."""
    found = []
    for name in names:
        short, bracket, case = name.partition("[")
        for file, tests in ((TESTS_OF_CLAUSES, TESTS), (TRAFFIC, TESTS_OF_TRAFFIC)):
            name = f"{file}::{tests[short]}{bracket}{case}" if short in tests else name
        found.append(name)
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
