"""rlco's small policies as a policy of LeRobot's commands."""

from lerobot_policy_rlco.configuration_rlco import RlcoConfig as RlcoConfig
from lerobot_policy_rlco.modeling_rlco import RlcoPolicy as RlcoPolicy
from lerobot_policy_rlco.processor_rlco import (
    make_rlco_pre_post_processors as make_rlco_pre_post_processors,
)
