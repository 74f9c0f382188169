"""Mutants of shields from observations alone, without an environment or with a grid."""

from __future__ import annotations

from mutants.kinds import off

__all__ = ["SOURCES"]

_SOURCES, _GRID = "tests/shield/perception/test_environment_free.py", "tests/shield/perception/test_grid_perception.py"
_LAYERS, _UNREADABLE = "tests/shield/perception/test_unwrapping.py", "tests/shield/perception/test_unreadable.py"
_BLIND, _UNDOING, _SIGHTING = (
    "shield.perception.environment_free",
    "shield.perception.unwrapping",
    "shield.perception.sighting",
)
_GRIDS, _CELLS = "shield.perception.grid_perception", "shield.perception.grid_sighting"

SOURCES = (
    off(
        "check of an ego away from its prediction off",
        _BLIND,
        "EnvironmentFreeScenes._strays",
        "bool((_ > _)._())",
        "False",
        f"{_SOURCES}::test_an_ego_that_did_not_execute_its_action_is_detected",
    ),
    off(
        "record of actions without a scene off",
        _BLIND,
        "EnvironmentFreeScenes.tell",
        "_() if _ is None else _",
        "{2}",
        f"{_SOURCES}::test_the_target_command_is_known_after_an_unreadable_observation",
    ),
    off(
        "correction of clipped values off",
        _UNDOING,
        "undo_vec_wrappers",
        "_[_] = _",
        "pass",
        f"{_LAYERS}::test_a_value_clipped_by_normalisation_is_unknown",
    ),
    off(
        "check of wrappers off",
        _UNDOING,
        "check_wrappers",
        "_ not in _",
        "False",
        f"{_LAYERS}::test_wrappers_that_cannot_be_undone_are_refused",
    ),
    off(
        "check of the observation's shape off",
        _SIGHTING,
        "numbers_of",
        "_ not in (_, (_(_),))",
        "given.size != {3}({2})",
        f"{_UNREADABLE}::test_an_unreadable_observation_leads_to_the_labelled_fallback",
    ),
    off(
        "offset of a body within its cell off",
        _GRIDS,
        "GridPerception._bodies",
        "_ + (_ - _)[:, :2]",
        "{1}",
        f"{_GRID}::test_true_bodies_are_inside_those_of_the_scene",
    ),
    off(
        "vehicles hidden in a shared cell off",
        _GRIDS,
        "GridPerception._hidden",
        "not _",
        "True",
        f"{_GRID}::test_a_cell_of_two_lanes_may_hide_a_vehicle",
    ),
    off(
        "vehicles beyond the grid off",
        _GRIDS,
        "GridPerception.see",
        "_(_, _[0], _, _, _, _(_))",
        "np.zeros((0, 4))",
        f"{_GRID}::test_a_slow_vehicle_is_assumed_beyond_the_grid",
    ),
    off(
        "ambiguous matches of cells off",
        _GRIDS,
        "GridPerception._take_in",
        "_ & (_(_=0) == 1)",
        "{1}",
        f"{_GRID}::test_ambiguous_vehicles_get_new_identities",
    ),
    off(
        "clipped speeds as unbounded off",
        _CELLS,
        "decode_grid",
        "_ |= _",
        "pass",
        f"{_GRID}::test_a_vehicle_too_fast_for_the_range_may_be_anywhere",
    ),
    off(
        "rotation of a grid aligned with the ego off",
        _CELLS,
        "decode_grid",
        "_ if _ else 0.0",
        "0.0",
        f"{_GRID}::test_every_vehicle_in_the_grid_is_inside_its_bounds",
    ),
)
"""Each of a line."""
