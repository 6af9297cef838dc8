"""The compiled loop of a task's rollouts: control steps, and what sensors tell."""

from __future__ import annotations

from typing import Any

from numba import njit

from rlco.physics.arm_kernels import control_step
from rlco.physics.copy_memory import SITE_MAT, SITE_POS, scratch
from rlco.physics.libmujoco import doubles
from rlco.physics.native_kernels import read_features


@njit(nogil=True, cache=True)
def roll_out_range(
    first: int,
    last: int,
    control: Any,
    memory: Any,
    tracked: Any,
    actions: Any,
    steps: Any,
    out: Any,
) -> None:
    """Execute `steps[e]` control steps of copies `first` to `last`.

    As `rlco.physics.native_kernels.step_range`, but the robot is written down where its
    encoders tell that it is.

    Args:
        first: The first copy.
        last: The copy after the last.
        control: The arm's controller.
        memory: Of all copies.
        tracked: Where features are read.
        actions: (copies, H, numbers).
        steps: (copies,).
        out: Written: the features after each step, (copies, H, features).
    """
    s = scratch(control)
    for e in range(first, last):
        for t in range(steps[e]):
            if memory.broken[e]:
                break
            memory.broken[e] = not control_step(control, memory, e, actions[e, t], s)
            if not memory.broken[e]:
                read_features(memory.fields[e], tracked, out[e, t])
                if control.acting.believed:
                    _tell(control, memory.seen[e], tracked, out[e, t])


@njit(nogil=True, cache=True)
def _tell(control: Any, seen: Any, tracked: Any, out: Any) -> None:
    """Write over a copy's features of the robot what its encoders tell."""
    out[0:3] = doubles(seen[SITE_POS] + 24 * tracked.site, 3)
    out[3:12] = doubles(seen[SITE_MAT] + 72 * tracked.site, 9)
    told = control.acting.told
    for i in range(tracked.arm_qpos.shape[0]):
        at = tracked.arm_qpos[i]
        out[14 + i] = told[0, at] * out[14 + i] + told[1, at]
