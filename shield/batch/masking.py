"""Action masks of many environments, as `shield.pipelines.meta_actions.MetaActionPipeline.mask` computes them."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.arrays import Worlds
from dynamics.pass_by_pointer import address_of, dereference
from dynamics.roads.straight import nearest
from dynamics.state import BoolArray
from shield.batch.arrays import BatchMemory, BatchPointers, BatchRecords, BatchWorkspace, scene_of
from shield.batch.deciding import is_blocked_alongside, target_of, verifies
from shield.batch.observing import observe
from shield.batch.parameters import BatchParameters
from shield.batch.verifying import frames_of

__all__ = ["mask_all"]


@kernel_no_refcount
def _mask(pointers: BatchPointers, e: int, mask: BoolArray) -> None:
    """Fill in the actions that verify in one environment, (actions,); none if the scene is not finite. The scene is
    observed."""
    shields, parameters, workspace = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.workspace),
    )
    lanes, wanted, found = workspace.marks[5], workspace.numbers[0], workspace.grid[2, :4]
    for a in range(mask.shape[0]):
        mask[a] = False
    if not observe(pointers, e):
        return
    scene = address_of(scene_of(shields, parameters, e))
    here, v = nearest(parameters.centers, shields.state[e, 1]), shields.ego[e, 3]
    for a in range(mask.shape[0]):
        lanes[a], wanted[a] = target_of(dereference(pointers.worlds), parameters, e, a)
        mask[a] = not is_blocked_alongside(shields, parameters, e, lanes[a])
    for changes in (False, True):
        most = -math.inf
        for a in range(mask.shape[0]):
            if mask[a] and (lanes[a] != here) == changes:
                most = max(most, wanted[a])
        if most == -math.inf:
            continue
        # The frames can cap the acceleration of a longitudinal action. A lane change should verify for the whole
        # decision.
        frames = frames_of(parameters, v, most, parameters.numbers.one)
        lasting = frames_of(parameters, v, most, parameters.numbers.period) if changes else 0
        for a in range(mask.shape[0]):
            if mask[a] and (lanes[a] != here) == changes:
                mask[a] = verifies(pointers, scene, e, (lanes[a], wanted[a]), frames, lasting, found)


@kernel_no_refcount
def mask_all(
    worlds: Worlds,
    shields: BatchMemory,
    parameters: BatchParameters,
    workspace: BatchWorkspace,
    records: BatchRecords,
    masks: BoolArray,
) -> None:
    """Fill in the actions that verify in each environment, (e, actions).

    Parameters
    ----------
    shields : memory; the scenes are observed. records : not written.
    """
    pointers = BatchPointers(
        address_of(shields), address_of(parameters), address_of(worlds), address_of(workspace), address_of(records)
    )
    for e in range(masks.shape[0]):
        _mask(pointers, e, masks[e])
