"""Scenes of observations: what the shield would overlook if a line were missing."""

from __future__ import annotations

from mutants.kinds import off

__all__ = ["OBSERVED"]

_DECODING_TESTS = "tests/shield/test_perception_decoding.py"
_TRACKING_TESTS = "tests/shield/test_perception_tracking.py"
_UNSEEN_TESTS = "tests/shield/test_perception_unseen.py"
_NOISE_TESTS = "tests/shield/test_perception_noise.py"
_TRACKING, _KERNELS = "shield/perception/tracking.py", "shield/perception/filter_kernels.py"
_UNSEEN, _PERCEIVING = "shield/perception/unseen.py", "shield/perception/perceiving.py"
_LEARNED, _MONITOR = "shield/perception/learned.py", "shield/perception/monitor.py"
_LEARNED_TESTS = "tests/shield/test_perception_learned.py"
_CHANGED = f"{_LEARNED_TESTS}::test_a_sensor_that_has_changed_is_answered_with_the_widest_bounds_and_no_guarantee"
_FRAMES = "shield/procedures/frames.py"
_BODIES, _MEMORY = "shield/perception/bodies.py", "shield/certificate/memory.py"

OBSERVED = (
    off(
        "nobody comes up who has never been seen",
        _UNSEEN,
        "for r in lanes if self.stranger > -reach]",
        "for r in lanes if False]",
        f"{_UNSEEN_TESTS}::test_a_stranger_comes_nearer_as_fast_as_it_may",
    ),
    off(
        "a stranger stays where it was",
        _UNSEEN,
        "self.stranger += (unseen.fastest - ego_speed) * passed",
        "pass",
        f"{_UNSEEN_TESTS}::test_a_stranger_comes_nearer_as_fast_as_it_may",
    ),
    off(
        "who was passed stands still",
        _UNSEEN,
        "pool[:, 0] += (pool[:, 2] - ego_speed) * passed",
        "pool[:, 0] -= ego_speed * passed",
        f"{_UNSEEN_TESTS}::test_who_was_passed_is_never_nearer_than_it_is_thought_to_be",
    ),
    off(
        "everybody is shown where all rows are full",
        _UNSEEN,
        "far, back = min(far, furthest), min(back, furthest)",
        "pass",
        f"{_DECODING_TESTS}::test_what_is_decoded_is_the_simulator_s_truth",
    ),
    off(
        "a sensor sees as far as highway-env shows",
        "shield/perception/spec.py",
        "far = min(self.distance, self.sensor_range)",
        "far = self.distance",
        "tests/evaluation/test_sensor_models.py::test_what_is_beyond_the_range_may_be_there",
    ),
    off(
        "the range of a sensor is not read",
        "shield/perception/scenes.py",
        ', sensor_range=float(getattr(sensor, "sensor_range", inf))',
        "",
        "tests/evaluation/test_sensor_models.py::test_what_is_beyond_the_range_may_be_there",
    ),
    off(
        "what wrappers have added is taken for what is shown",
        "shield/perception/scenes.py",
        "rows[..., :-added] if added and rows.ndim > 1 else observation",
        "observation",
        "tests/evaluation/test_channels.py::test_a_shield_decides_as_without_the_channels",
    ),
    off(
        "shuffled rows are the nearest",
        _UNSEEN,
        "if not spec.sorted or sighting.cut:",
        "if sighting.cut:",
        f"{_UNSEEN_TESTS}::test_shuffled_rows_of_too_many_say_nothing_of_who_is_left_out",
    ),
    off(
        "nobody slow is beyond the edge",
        _PERCEIVING,
        "np.concatenate([ahead(spec, far, unseen, road, ego, seen), behind])",
        "behind",
        f"{_UNSEEN_TESTS}::test_somebody_slow_beyond_the_edge_is_in_the_scene",
    ),
    off(
        "bodies reach no further than they are thought to be",
        _BODIES,
        "rows[a, _LENGTH] += high[a, 0] - low[a, 0]",
        "pass",
        f"{_NOISE_TESTS}::test_what_is_late_is_taken_to_where_it_is_by_now",
    ),
    off(
        "speeds are what they are thought to be",
        _BODIES,
        "states[a, 2] = high[a, 2] if mean[a, 0] < x else low[a, 2]",
        "states[a, 2] = mean[a, 2]",
        f"{_NOISE_TESTS}::test_whoever_is_within_the_bounds_is_covered_by_the_body_and_as_fast_as_it_or_less_in_the_way",
    ),
    off(
        "rows say nothing of who is who",
        _KERNELS,
        " + (SWAP * min(swaps, SWAPS) if swaps == swaps else 0.0)",
        "",
        f"{_TRACKING_TESTS}::test_rows_that_are_sorted_say_who_is_who_where_what_they_show_does_not",
    ),
    off(
        "a bad sensor is believed of newcomers",
        _TRACKING,
        "mean[:, k] += seen_by / (seen_by + spread**2) * (usual - seen[:, k])",
        "pass",
        f"{_TRACKING_TESTS}::test_nobody_is_taken_to_be_as_fast_as_a_bad_sensor_shows",
    ),
    off(
        "a side is the middle",
        _KERNELS,
        "found[1, a, k] = _edge(chances[a], (m[0, k], m[1, k], m[2, k]), s, bounds[1, k], above)",
        "found[1, a, k] = _edge(chances[a], (m[0, k], m[1, k], m[2, k]), s, 0.0, 0.5)",
        f"{_TRACKING_TESTS}::test_the_sides_of_a_mixture_are_exceeded_as_often_as_they_say",
    ),
    off(
        "noise widens what was known",
        _MEMORY,
        "scene = nested(last.scene, last.around, same, scene)",
        "pass",
        f"{_NOISE_TESTS}::test_bounds_are_no_wider_than_what_was_known_before",
    ),
    off(
        "who may come is told by the row",
        _MEMORY,
        "comes[:, same >= 0] = last.comes[:, same[same >= 0]]",
        "comes[:] = last.comes",
        f"{_TRACKING_TESTS}::test_the_order_of_the_rows_changes_nothing",
    ),
    off(
        "what was lost by turning is forgotten",
        _MEMORY,
        "tables.numbers[:, known] = last.tables.marks[:, then], last.tables.numbers[:, then]",
        "tables.numbers[:, known] = last.tables.marks[:, then], tables.numbers[:, known]",
        f"{_TRACKING_TESTS}::test_what_is_remembered_of_those_known_again_is_what_is_remembered_in_exact_scenes",
    ),
    off("nobody monitors the sensor", _MONITOR, "return self.excess > _LIMIT", "return False", _CHANGED),
    off(
        "an alarm leaves the bounds as they are",
        _PERCEIVING,
        "return np.full((2, 4), FARTHEST)",
        "pass",
        _CHANGED,
    ),
    off(
        "an alarm narrows by who was there before",
        _PERCEIVING,
        "ids = np.full(len(rows), -1)",
        "pass",
        _CHANGED,
    ),
    off(
        "an alarm leaves the guarantee",
        _PERCEIVING,
        "return Guarantee.NONE, 0.0",
        "pass",
        _CHANGED,
    ),
    off(
        "what was seen a decision ago counts on",
        _MONITOR,
        "if each[0] > frame - frames)",
        "if True)",
        f"{_LEARNED_TESTS}::test_what_is_older_than_a_decision_counts_no_more",
    ),
    off(
        "noise is what little says",
        _LEARNED,
        "np.sqrt(self.squares / (self.count * share**3))",
        "np.sqrt(0.9 * self.squares / self.count)",
        f"{_LEARNED_TESTS}::test_noise_is_taken_to_be_no_less_than_it_is_while_little_was_seen",
    ),
    off(
        "an unknown sensor is a good one",
        _LEARNED,
        "return WIDEST.copy()",
        "return RESOLUTION.copy()",
        f"{_LEARNED_TESTS}::test_nothing_is_known_before_anything_was_seen",
    ),
    off(
        "bounds do not answer to being missed",
        _LEARNED,
        "levels = self.levels + _GAMMA *",
        "levels = self.levels + 0.0 *",
        f"{_LEARNED_TESTS}::test_as_many_are_beyond_the_bounds_as_chosen_whatever_the_distribution",
    ),
    off(
        "the widest bounds are never missed",
        _LEARNED,
        "(scores > high) | (scores >= FARTHEST)",
        "(scores > high)",
        f"{_LEARNED_TESTS}::test_where_even_the_widest_bounds_are_missed_they_stay",
    ),
    off(
        "conformal bounds are not used",
        _PERCEIVING,
        "return self.learned.conformal.bounds",
        "pass",
        f"{_LEARNED_TESTS}::test_bodies_reach_as_far_as_the_conformal_bounds_say",
    ),
    off(
        "through noise the fallback looks at bounds alone",
        _FRAMES,
        "if now.scene.likely is not None:",
        "if False:",
        f"{_NOISE_TESTS}::test_among_bounds_it_goes_by_where_the_others_are_likely",
    ),
    off(
        "the fallback leaves its lane for one that looks freer",
        _FRAMES,
        "yield own & (narrow[-1].margin >= 0)",
        "yield narrow[-1].margin >= 0",
        "tests/evaluation/test_splitting.py::test_crashes_that_splitting_has_found_are_avoided",
    ),
)
"""Each of a line."""
