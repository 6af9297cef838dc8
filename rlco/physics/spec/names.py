"""Names that files and options use: tasks, and dimensions of states and actions."""

from __future__ import annotations

from typing import Literal, get_args

from rlco.physics.spec.robot import PANDA

#: rlco's own tasks: each is the module of that name in `rlco.physics.tasks`, with TASK.
TASK_NAMES = ("push_cube", "pick_and_place", "open_drawer", "close_drawer")
# Of the robot that all of them use; a task's own are `state_names`, `action_names`.
STATE_NAMES, ACTION_NAMES = PANDA.state_names, PANDA.action_names

# What draws camera frames: rlco itself, or OpenGL through MuJoCo.
Renderer = Literal["raster", "opengl"]
RENDERERS: tuple[str, ...] = get_args(Renderer)
