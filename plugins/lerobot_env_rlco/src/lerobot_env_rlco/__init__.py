"""rlco's tasks as an environment of LeRobot's commands: ``--env.type=rlco``."""

from lerobot_env_rlco.env import RlcoEnv as RlcoEnv
