"""Observations alone: what a shield without an environment, or with a grid, would overlook if a line were missing."""

from __future__ import annotations

from mutants.kinds import off

__all__ = ["SOURCES"]

_SOURCES, _GRID = "tests/shield/test_perception_sources.py", "tests/shield/test_perception_grid.py"
_LAYERS, _UNREADABLE = "tests/shield/test_perception_layers.py", "tests/shield/test_perception_unreadable.py"
_BLIND, _UNDOING, _SIGHTING = (
    "shield/perception/blind.py",
    "shield/perception/undoing.py",
    "shield/perception/sighting.py",
)
_GRIDS, _CELLS = "shield/perception/grid_perception.py", "shield/perception/grid_sighting.py"

SOURCES = (
    off(
        "an ego that went astray is followed all the same",
        _BLIND,
        "return bool((apart > self._astray).any())",
        "return False",
        f"{_SOURCES}::test_an_ego_that_is_not_where_it_was_told_to_go_is_noticed",
    ),
    off(
        "what was told is forgotten where nothing is seen",
        _BLIND,
        "scene = self._alone() if self._scene is None else self._scene",
        "scene = self._scene",
        f"{_SOURCES}::test_what_the_ego_was_told_is_known_where_nothing_can_be_read",
    ),
    off(
        "what was clipped is taken for what was there",
        _UNDOING,
        "undone[cut] = np.nan",
        "pass",
        f"{_LAYERS}::test_what_normalisation_has_cut_off_is_not_known",
    ),
    off(
        "any wrapper may stand between",
        _UNDOING,
        "        if name not in SAME:\n",
        "        if False:\n",
        f"{_LAYERS}::test_wrappers_that_cannot_be_undone_are_refused",
    ),
    off(
        "numbers of any shape are read",
        _SIGHTING,
        "if given.shape not in (shape, (math.prod(shape),)):",
        "if given.size != math.prod(shape):",
        f"{_UNREADABLE}::test_what_cannot_be_read_is_answered_with_the_labelled_fallback",
    ),
    off(
        "a body is in the middle of its cell",
        _GRIDS,
        "= self.spec.body + (high - low)[:, :2]",
        "= self.spec.body",
        f"{_GRID}::test_true_bodies_are_inside_those_of_the_scene",
    ),
    off(
        "a cell hides nobody",
        _GRIDS,
        "        if not spec.hides:\n",
        "        if True:\n",
        f"{_GRID}::test_in_a_cell_of_two_lanes_somebody_may_be_hidden",
    ),
    off(
        "beyond the grid nobody is",
        _GRIDS,
        "ahead(self.spec, self.edges[0], unseen, self._road, place, to_road(rows)),  # type: ignore[arg-type]",
        "np.zeros((0, 4)),",
        f"{_GRID}::test_beyond_the_grid_somebody_slow_is_assumed",
    ),
    off(
        "of two who may be the same one is",
        _GRIDS,
        "near & (near.sum(axis=0) == 1) & (near.sum(axis=1) == 1)[:, None]",
        "near & (near.sum(axis=1) == 1)[:, None]",
        f"{_GRID}::test_nobody_is_taken_for_another_where_it_may_be_either",
    ),
    off(
        "who is too fast for the range is at its edge",
        _CELLS,
        "            cut |= edge\n",
        "            pass\n",
        f"{_GRID}::test_who_is_too_fast_for_the_range_is_somebody_of_whom_nothing_is_known",
    ),
    off(
        "a grid along the ego is taken to lie along the road",
        _CELLS,
        "heading if spec.aligned else 0.0)",
        "0.0)",
        f"{_GRID}::test_everybody_in_the_grid_is_inside_its_bounds",
    ),
)
"""Each of a line."""
