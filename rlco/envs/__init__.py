"""The tasks as TorchRL environments, and other environments under the same keys."""

import importlib
from typing import TYPE_CHECKING, Any

from rlco.envs.action_units import check_action_units as check_action_units
from rlco.envs.canonical import canonical as canonical
from rlco.envs.canonical import from_mujoco as from_mujoco
from rlco.envs.canonical import from_vla as from_vla
from rlco.envs.from_gymnasium import from_gymnasium as from_gymnasium
from rlco.envs.tabletop_env import TabletopEnv as TabletopEnv
from rlco.physics.tasks.registration import gymnasium_id as gymnasium_id

if TYPE_CHECKING:
    from rlco.envs.make import make_env as make_env
    from rlco.physics.tasks.plain_robosuite import make_robosuite as make_robosuite

# What needs robosuite, which costs seconds to import and of which LIBERO brings
# another version.
_LATER = {
    "make_env": "rlco.envs.make",
    "make_robosuite": "rlco.physics.tasks.plain_robosuite",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(importlib.import_module(_LATER[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
