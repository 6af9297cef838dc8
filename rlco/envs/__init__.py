"""The tasks as TorchRL environments, and the robosuite environments behind them."""

from rlco.envs.make import make_env as make_env
from rlco.envs.tabletop_env import TabletopEnv as TabletopEnv
from rlco.physics.tabletop import make_robosuite as make_robosuite
