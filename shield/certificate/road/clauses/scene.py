"""Prepares a scene for the clauses, in one compiled call."""

from __future__ import annotations

from dynamics.compiled import inlined, numbers_of
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.rules_of_the_road import Ego
from dynamics.traffic.tables import bodies_of
from shield.certificate.road.clauses.cut_in import may_slip
from shield.certificate.road.clauses.followers import Standing, counted_on, others_of
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import others_from
from shield.certificate.road.clauses.parameters import settings_from, sight_of

__all__ = ["counts", "seen"]


@inlined
def counts(
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
    """`counted_on`, for the arrays that `seen` fills in."""
    others = others_from(bodies_of(marks, numbers, brakes, recent), of_others, flags)
    counted_on(others, state, Footprint(*numbers_of(size, 8)), centers, plan, owned, before, counted)


@inlined
def seen(
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
    centers, settings : of the lanes [m]; numbers of `Settings`.
    owned, visible, plan : see `Standing`; `plan` is its `stored` and `entered`.
    followers, before : see `others_of`.
    of_others, flags : arrays of `Others`, see `empty_others`; written.
    slipping : vehicles that `may_slip` finds, (2 m, 4); written.
    tempted : buffer, (m, 4).

    Returns
    -------
    Number of vehicles that may cut in.
    """
    x, bodies, foot = (
        settings_from(settings),
        bodies_of(marks, numbers, brakes, recent),
        Footprint(*numbers_of(size, 8)),
    )
    body = 0.5 * foot.length, 0.5 * foot.width
    world = Ego(vehicle[0], vehicle[1], vehicle[2], vehicle[3], foot.along, foot.across, body[0], body[1], False, False)
    others = others_from(bodies, of_others, flags)
    ego = Standing(state, foot, world, owned, visible, plan[0], plan[1])
    others_of(rows, states, bodies, ego, followers, before, sight_of(x), centers, others, tempted)
    if not x.slip_in > 0:
        return 0
    return may_slip(rows, states, bodies, state, foot.length, centers, x.seen, x.hardest, slipping)
