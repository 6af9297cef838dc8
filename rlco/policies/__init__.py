"""What acts: policies on TensorDicts, their value network, and their checkpoints."""

from rlco.policies.actor import Actor as Actor
from rlco.policies.nets.image_encoder import ImageArguments as ImageArguments
from rlco.policies.nets.image_encoder import ImageEncoder as ImageEncoder
from rlco.policies.nets.value import ValueHead as ValueHead
from rlco.policies.nets.value import ValueNetwork as ValueNetwork
from rlco.policies.small.checkpoint import load_policy as load_policy
from rlco.policies.small.checkpoint import load_weights as load_weights
from rlco.policies.small.checkpoint import save_policy as save_policy
from rlco.policies.small.chunk_policy import ChunkPolicy as ChunkPolicy
from rlco.policies.small.flow import FlowPolicy as FlowPolicy
from rlco.policies.small.gaussian import GaussianPolicy as GaussianPolicy
from rlco.policies.small.observation_check import (
    check_observations as check_observations,
)
from rlco.policies.small.registry import make_policy as make_policy
from rlco.policies.small.task_compat import load_task_policy as load_task_policy
from rlco.policies.small.task_compat import task_sizes as task_sizes
from rlco.policies.small.token import TokenPolicy as TokenPolicy
