"""Prepares a scene for the clauses, in one compiled call."""

from __future__ import annotations

from typing import NamedTuple

from dynamics.compiled import kernel_inline, row_as_tuple
from dynamics.state import BoolArray, FloatArray
from dynamics.traffic.rules_of_the_road import EgoFootprint
from dynamics.traffic.tables import VehicleTables, bodies_in
from shield.certificate.road.clauses.clause_inputs import EarlierVehicles, EgoArrays, LaneState
from shield.certificate.road.clauses.cut_in import find_cut_ins
from shield.certificate.road.clauses.followers import EgoInScene, fill_vehicles, mark_relied_on
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import VehicleBuffers, vehicles_from
from shield.certificate.road.clauses.parameters import settings_from, visibility_of

__all__ = ["SceneBuffers", "find_relied_on", "prepare_scene"]


class SceneBuffers(NamedTuple):
    """Arrays that `prepare_scene` writes.

    Attributes
    ----------
    of_others : see `empty_vehicles`. cutting_in : vehicles that `find_cut_ins` finds, (2 m, 4).
    tempted : buffer, (m, 4).
    """

    of_others: VehicleBuffers
    cutting_in: FloatArray
    tempted: BoolArray


@kernel_inline
def find_relied_on(
    vehicles: VehicleTables,
    of_others: VehicleBuffers,
    ego: EgoArrays,
    lanes: LaneState,
    plan: tuple[int, int],
    before: tuple[BoolArray, BoolArray],
    counted: BoolArray,
) -> None:
    """`mark_relied_on`, for the arrays that `prepare_scene` fills in."""
    others = vehicles_from(bodies_in(vehicles).bodies, of_others.numbers, of_others.flags)
    mark_relied_on(others, ego.state, Footprint(*row_as_tuple(ego.size, 8)), lanes, plan, before, counted)


@kernel_inline
def prepare_scene(
    vehicles: VehicleTables,
    ego: EgoArrays,
    lanes: LaneState,
    settings: FloatArray,
    plan: tuple[int, int],
    earlier: EarlierVehicles,
    out: SceneBuffers,
) -> int:
    """Prepare a scene: fill in everything about the other vehicles that does not depend on a path.

    Parameters
    ----------
    settings : numbers of `ClauseSettings`. plan : `EgoInScene.stored` and `EgoInScene.entered`.
    out : written.

    Returns
    -------
    Number of vehicles that may cut in.
    """
    x, bodies, foot = settings_from(settings), bodies_in(vehicles), Footprint(*row_as_tuple(ego.size, 8))
    row, body = ego.vehicle, (0.5 * foot.length, 0.5 * foot.width)
    world = EgoFootprint(row[0], row[1], row[2], row[3], foot.along, foot.across, body[0], body[1], False, False)
    others = vehicles_from(bodies.bodies, out.of_others.numbers, out.of_others.flags)
    seen = EgoInScene(ego.state, foot, world, lanes, plan[0], plan[1])
    fill_vehicles(bodies, seen, earlier, visibility_of(x), others, out.tempted)
    if not x.cut_in > 0:
        return 0
    return find_cut_ins(bodies, ego.state, foot.length, lanes.centers, x.seen, x.hardest, out.cutting_in)
