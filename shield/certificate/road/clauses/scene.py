"""Prepares a scene for the clauses, in one compiled call."""

from __future__ import annotations

from dynamics.compiled import kernel_inline, row_as_tuple
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.rules_of_the_road import EgoFootprint
from dynamics.traffic.tables import bodies_of
from shield.certificate.road.clauses.cut_in import find_cut_ins
from shield.certificate.road.clauses.followers import EgoInScene, fill_vehicles, mark_relied_on
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import vehicles_from
from shield.certificate.road.clauses.parameters import settings_from, visibility_of

__all__ = ["find_relied_on", "prepare_scene"]


@kernel_inline
def find_relied_on(
    marks: IntArray,
    numbers: FloatArray,
    brakes: FloatArray,
    recent: FloatArray,
    of_others: FloatArray,
    flags: BoolArray,
    state: FloatArray,
    size: FloatArray,
    centers: FloatArray,
    plan: tuple[int, int],
    owned: BoolArray,
    before: tuple[BoolArray, BoolArray],
    counted: BoolArray,
) -> None:
    """`mark_relied_on`, for the arrays that `prepare_scene` fills in."""
    others = vehicles_from(bodies_of(marks, numbers, brakes, recent), of_others, flags)
    mark_relied_on(others, state, Footprint(*row_as_tuple(size, 8)), centers, plan, owned, before, counted)


@kernel_inline
def prepare_scene(
    rows: FloatArray,
    states: FloatArray,
    marks: IntArray,
    numbers: FloatArray,
    brakes: FloatArray,
    recent: FloatArray,
    vehicle: FloatArray,
    state: FloatArray,
    size: FloatArray,
    centers: FloatArray,
    settings: FloatArray,
    owned: BoolArray,
    visible: IntArray,
    plan: tuple[int, int],
    followers: BoolArray,
    before: BoolArray,
    of_others: FloatArray,
    flags: BoolArray,
    slipping: FloatArray,
    tempted: BoolArray,
) -> int:
    """Prepare a scene: fill in everything about the other vehicles that does not depend on a path.

    Parameters
    ----------
    rows, states : vehicle rows (m, 7), and road states (m, 4). marks, numbers, brakes, recent : their `Tables`.
    vehicle, state, size : of the ego: vehicle row (7,), road state (4,), numbers of its `Footprint` (8,).
    centers, settings : of the lanes [m]; numbers of `ClauseSettings`.
    owned, visible, plan : see `EgoInScene`; `plan` is its `stored` and `entered`.
    followers, before : see `fill_vehicles`.
    of_others, flags : arrays of `RoadVehicles`, see `empty_vehicles`; written.
    slipping : vehicles that `find_cut_ins` finds, (2 m, 4); written.
    tempted : buffer, (m, 4).

    Returns
    -------
    Number of vehicles that may cut in.
    """
    x, bodies, foot = (
        settings_from(settings),
        bodies_of(marks, numbers, brakes, recent),
        Footprint(*row_as_tuple(size, 8)),
    )
    body = 0.5 * foot.length, 0.5 * foot.width
    world = EgoFootprint(
        vehicle[0], vehicle[1], vehicle[2], vehicle[3], foot.along, foot.across, body[0], body[1], False, False
    )
    others = vehicles_from(bodies, of_others, flags)
    ego = EgoInScene(state, foot, world, owned, visible, plan[0], plan[1])
    fill_vehicles(rows, states, bodies, ego, followers, before, visibility_of(x), centers, others, tempted)
    if not x.slip_in > 0:
        return 0
    return find_cut_ins(rows, states, bodies, state, foot.length, centers, x.seen, x.hardest, slipping)
