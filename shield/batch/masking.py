"""Action masks of many environments, as `shield.pipelines.meta_actions.MetaActions.mask` computes them."""

from __future__ import annotations

import math

from dynamics.compiled import uncounted
from dynamics.highway_simulator.step_kernels import Worlds
from dynamics.pass_by_pointer import held, lent
from dynamics.roads.straight import nearest
from dynamics.state import BoolArray
from shield.batch.arrays import Bench, Records, Room, Shields, scene_of
from shield.batch.deciding import objects, target_of, verifies
from shield.batch.observing import observe
from shield.batch.parameters import Law
from shield.batch.verifying import frames_of

__all__ = ["mask_all"]


@uncounted
def _mask(bench: Bench, e: int, mask: BoolArray) -> None:
    """Fill in the actions that verify in one environment, (actions,); none if the scene is not finite. The scene is
    observed."""
    shields, law, room = held(bench.shields), held(bench.law), held(bench.room)
    lanes, wanted, found = room.marks[5], room.numbers[0], room.grid[2, :4]
    for a in range(mask.shape[0]):
        mask[a] = False
    if not observe(bench, e):
        return
    scene = lent(scene_of(shields, law, e))
    here, v = nearest(law.centers, shields.state[e, 1]), shields.ego[e, 3]
    for a in range(mask.shape[0]):
        lanes[a], wanted[a] = target_of(held(bench.worlds), law, e, a)
        mask[a] = not objects(shields, law, e, lanes[a])
    for changes in (False, True):
        most = -math.inf
        for a in range(mask.shape[0]):
            if mask[a] and (lanes[a] != here) == changes:
                most = max(most, wanted[a])
        if most == -math.inf:
            continue
        # The frames can cap the acceleration of a longitudinal action. A lane change should verify for the whole
        # decision.
        frames = frames_of(law, v, most, law.numbers.one)
        lasting = frames_of(law, v, most, law.numbers.period) if changes else 0
        for a in range(mask.shape[0]):
            if mask[a] and (lanes[a] != here) == changes:
                mask[a] = verifies(bench, scene, e, lanes[a], wanted[a], frames, lasting, found)


@uncounted
def mask_all(worlds: Worlds, shields: Shields, law: Law, room: Room, records: Records, masks: BoolArray) -> None:
    """Fill in the actions that verify in each environment, (e, actions).

    Parameters
    ----------
    shields : memory; the scenes are observed. records : not written.
    """
    bench = Bench(lent(shields), lent(law), lent(worlds), lent(room), lent(records))
    for e in range(masks.shape[0]):
        _mask(bench, e, masks[e])
