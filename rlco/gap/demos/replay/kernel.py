"""The compiled loop of a task's rollouts: control steps and sensor reports."""

from __future__ import annotations

from typing import Any

from numba import njit

from rlco.physics.mj.compiling import inner
from rlco.physics.mj.copying import copy_into
from rlco.physics.mj.libmujoco import doubles
from rlco.physics.native.arm_kernels import control_step
from rlco.physics.native.kernels import JOINTS, TOOL, TURN, read_features
from rlco.physics.native.world_memory import SITE_MAT, SITE_POS, scratch


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
    """Execute `steps[e]` control steps in worlds `first` to `last`.

    As `rlco.physics.native.kernels.step_range`, but the robot's features are those that
    its encoders report.

    Args:
        first: The first world.
        last: The world after the last.
        control: The arm's controller.
        memory: Of all worlds.
        tracked: Addresses of features.
        actions: (worlds, H, action dimensions).
        steps: (worlds,).
        out: Output: the features after each step, (worlds, H, features).
    """
    s = scratch(control)
    for e in range(first, last):
        for t in range(steps[e]):
            if memory.broken[e]:
                break
            memory.broken[e] = not control_step(control, memory, e, actions[e, t], s)
            if not memory.broken[e]:
                read_features(memory.fields[e], tracked, out[e, t])
                if control.acting.controller_model:
                    _report_encoders(control, memory.observed[e], tracked, out[e, t])


@inner
def _report_encoders(control: Any, observed: Any, tracked: Any, out: Any) -> None:
    """Overwrite a world's robot features with the report of its encoders."""
    copy_into(out, TOOL, doubles(observed[SITE_POS] + 24 * tracked.site, 3))
    copy_into(out, TURN, doubles(observed[SITE_MAT] + 72 * tracked.site, 9))
    reported = control.acting.reported
    for i in range(tracked.arm_qpos.shape[0]):
        at = tracked.arm_qpos[i]
        out[JOINTS + i] = reported[0, at] * out[JOINTS + i] + reported[1, at]
