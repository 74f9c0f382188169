"""Mutants of scenes from observations."""

from __future__ import annotations

from mutants.kinds import off

__all__ = ["OBSERVED"]

_DECODING_TESTS = "tests/shield/perception/test_sighting.py"
_TRACKING_TESTS = "tests/shield/perception/test_tracking.py"
_UNSEEN_TESTS = "tests/shield/perception/test_unseen.py"
_NOISE_TESTS = "tests/shield/perception/test_noise.py"
_TRACKING, _KERNELS = "shield.perception.tracking", "shield.perception.filter_kernels"
_UNSEEN, _PERCEIVING = "shield.perception.unseen", "shield.perception.perceiving"
_LEARNED, _MONITOR = "shield.perception.learned", "shield.perception.sensor_monitor"
_LEARNED_TESTS = "tests/shield/perception/test_learned.py"
_CHANGED = f"{_LEARNED_TESTS}::test_a_changed_sensor_gets_the_widest_bounds_and_no_guarantee"
_FRAMES = "shield.pipelines.frames"
_BODIES, _MEMORY = "shield.perception.bodies", "shield.certificate.road.memory"

OBSERVED = (
    off(
        "unseen vehicles behind off",
        _UNSEEN,
        "UnseenBehind.states",
        "_ > -_",
        "False",
        f"{_UNSEEN_TESTS}::test_an_unseen_vehicle_approaches_at_its_assumed_limit",
        which=1,
    ),
    off(
        "approach of unseen vehicles off",
        _UNSEEN,
        "UnseenBehind.go_on",
        "_ += (_ - _) * _",
        "pass",
        f"{_UNSEEN_TESTS}::test_an_unseen_vehicle_approaches_at_its_assumed_limit",
    ),
    off(
        "motion of passed vehicles off",
        _UNSEEN,
        "UnseenBehind.go_on",
        "_[:, 0] += (_[:, 2] - _) * _",
        "{1}[:, 0] -= {3} * {4}",
        f"{_UNSEEN_TESTS}::test_a_passed_vehicle_is_never_nearer_than_its_bound",
    ),
    off(
        "edge of what full rows show off",
        _UNSEEN,
        "edges",
        "_, _ = (min(_, _), min(_, _))",
        "pass",
        f"{_DECODING_TESTS}::test_a_decoded_observation_is_the_state_of_the_simulator",
    ),
    off(
        "the spec's sensor range off",
        "shield.perception.spec",
        "ObservationSpec.sight",
        "min(_, _)",
        "{1}",
        "tests/evaluation/wrappers/test_sensor_model.py::test_an_unseen_vehicle_is_assumed_beyond_the_range",
        which=1,
    ),
    off(
        "the sensor's range attribute off",
        "shield.perception.scenes",
        "ObservedScenes.check",
        "_(_, _=False, _=float(getattr(_, 'sensor_range', _)))",
        "{1}({2}, clip=False)",
        "tests/evaluation/wrappers/test_sensor_model.py::test_an_unseen_vehicle_is_assumed_beyond_the_range",
    ),
    off(
        "removal of features that wrappers add off",
        "shield.perception.scenes",
        "ObservedScenes.show",
        "_[..., :-_] if _ and _ > 1 else _",
        "{5}",
        "tests/evaluation/wrappers/test_channels.py::test_a_shield_decides_as_without_the_channels",
    ),
    off(
        "check for shuffled rows off",
        _UNSEEN,
        "edges",
        "not _ or _",
        "{2}",
        f"{_UNSEEN_TESTS}::test_a_full_shuffled_observation_gives_no_edge",
    ),
    off(
        "slow vehicles beyond the sensor's edge off",
        _PERCEIVING,
        "ObservationPerception._ghosts",
        "_([_(_, _, _, _, _, _), _])",
        "{9}",
        f"{_UNSEEN_TESTS}::test_a_slow_vehicle_beyond_the_edge_is_in_the_scene",
    ),
    off(
        "lengthening of bodies by their bounds off",
        _BODIES,
        "_lengthen",
        "_[_, _] += _[_, 0] - _[_, 0]",
        "pass",
        f"{_NOISE_TESTS}::test_a_delayed_observation_is_extrapolated_to_the_present",
    ),
    off(
        "bounds on speeds off",
        _BODIES,
        "_widen",
        "_[_, 2] if _[_, 0] < _ else _[_, 2]",
        "{3}[{2}, 2]",
        f"{_NOISE_TESTS}::test_a_vehicle_within_the_bounds_is_covered_by_the_body_of_the_scene",
    ),
    off(
        "matching by row off",
        _KERNELS,
        "_price",
        "min(_[_, _], _) + (_ * min(_, _) if _ == _ else 0.0)",
        "min({1}[{2}, {3}], {4})",
        f"{_TRACKING_TESTS}::test_the_order_of_sorted_rows_identifies_vehicles_under_large_noise",
    ),
    off(
        "prior of a new track's velocity off",
        _TRACKING,
        "_initial_estimate",
        "_[:, _] += _ / (_ + _ ** 2) * (_ - _[:, _])",
        "pass",
        f"{_TRACKING_TESTS}::test_the_speed_of_a_bad_sensor_is_weighed_against_the_prior",
    ),
    off(
        "side quantiles of a mixture off",
        _KERNELS,
        "_find",
        "_(_[_], (_[0, _], _[1, _], _[2, _]), _, _[1, _], _)",
        "{1}({2}[{3}], ({4}[0, {5}], {4}[1, {5}], {4}[2, {5}]), {10}, 0.0, 0.5)",
        f"{_TRACKING_TESTS}::test_the_sides_of_a_mixture_are_exceeded_as_often_as_they_say",
    ),
    off(
        "nesting of noisy bounds over time off",
        _MEMORY,
        "observe",
        "_ = _(_, _, _, _)",
        "pass",
        f"{_NOISE_TESTS}::test_bounds_are_no_wider_than_those_predicted_from_the_frame_before",
    ),
    off(
        "matching of vehicles that may enter, by identity, off",
        _MEMORY,
        "_lanes",
        "_[:, _ >= 0] = _[:, _[_ >= 0]]",
        "{1}[:] = {3}",
        f"{_TRACKING_TESTS}::test_the_order_of_the_rows_changes_nothing",
    ),
    off(
        "memory of turning allowances off",
        _MEMORY,
        "_before",
        "_[:, _], _[:, _] = (_[:, _], _[:, _])",
        "{1}[:, {2}], {3}[:, {2}] = ({5}[:, {6}], {3}[:, {2}])",
        f"{_TRACKING_TESTS}::test_the_memory_of_recognised_vehicles_is_that_of_exact_scenes",
    ),
    off(
        "sensor monitor off",
        _MONITOR,
        "SensorMonitor.alarmed",
        "_ > _",
        "False",
        _CHANGED,
    ),
    off(
        "wider bounds after an alarm off",
        _PERCEIVING,
        "ObservationPerception.bounds",
        "return _((2, 4), _)",
        "pass",
        _CHANGED,
    ),
    off(
        "reset of identities after an alarm off",
        _PERCEIVING,
        "ObservationPerception._scene",
        "_ = _(len(_), -1)",
        "pass",
        _CHANGED,
    ),
    off(
        "loss of the guarantee after an alarm off",
        _PERCEIVING,
        "ObservationPerception.rating",
        "return (_, 0.0)",
        "pass",
        _CHANGED,
    ),
    off(
        "time window of the sensor monitor off",
        _MONITOR,
        "SensorMonitor.after",
        "_[0] > _ - _",
        "True",
        f"{_LEARNED_TESTS}::test_observations_older_than_a_decision_do_not_count_for_the_alarm",
    ),
    off(
        "confidence bound of few noise samples off",
        _LEARNED,
        "Noise.sigma",
        "_ / (_ * _ ** 3)",
        "0.9 * {1} / {2}",
        f"{_LEARNED_TESTS}::test_noise_is_not_underestimated_from_few_observations",
    ),
    off(
        "initial noise of an unknown sensor off",
        _LEARNED,
        "Noise.sigma",
        "_()",
        "RESOLUTION.copy()",
        f"{_LEARNED_TESTS}::test_no_noise_estimate_exists_before_an_observation",
    ),
    off(
        "adaptation of conformal bounds off",
        _LEARNED,
        "Conformal.after",
        "_ * (_ * _ - _(_)._(_=1))",
        "0.0 * ({2} * {3} - {4}({5}).sum(axis=1))",
        f"{_LEARNED_TESTS}::test_the_chosen_share_exceeds_conformal_bounds_for_any_distribution",
    ),
    off(
        "count of misses at the widest bounds off",
        _LEARNED,
        "Conformal.missed",
        "(_ > _) | (_ >= _)",
        "{1} > {2}",
        f"{_LEARNED_TESTS}::test_the_widest_bounds_do_not_grow",
    ),
    off(
        "conformal bounds are not used",
        _PERCEIVING,
        "ObservationPerception.bounds",
        "return _",
        "pass",
        f"{_LEARNED_TESTS}::test_bodies_reach_as_far_as_the_conformal_bounds_say",
        which=1,
    ),
    off(
        "fallback on shrunk bounds off",
        _FRAMES,
        "FramePipeline.fall_back",
        "_ is not None",
        "False",
        f"{_NOISE_TESTS}::test_the_fallback_uses_the_likely_places_inside_bounds",
        which=2,
    ),
    off(
        "preference of the fallback for its lane off",
        _FRAMES,
        "_least_bad_of_shrunk_bounds.clear",
        "_ & (_[-1]._ >= 0)",
        "{2}[-1].margin >= 0",
        "tests/evaluation/falsification/test_splitting.py::test_crashes_that_splitting_has_found_are_avoided",
    ),
)
"""Each of a line."""
