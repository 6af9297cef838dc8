"""What acts: policies on TensorDicts, their value network, and their checkpoints."""

from rlco.policies.actor import Actor as Actor
from rlco.policies.checkpoint import load_policy as load_policy
from rlco.policies.checkpoint import load_weights as load_weights
from rlco.policies.checkpoint import save_policy as save_policy
from rlco.policies.chunk_policy import ChunkPolicy as ChunkPolicy
from rlco.policies.fit import load_task_policy as load_task_policy
from rlco.policies.fit import task_sizes as task_sizes
from rlco.policies.flow import FlowPolicy as FlowPolicy
from rlco.policies.gaussian import GaussianPolicy as GaussianPolicy
from rlco.policies.image_encoder import ImageArguments as ImageArguments
from rlco.policies.image_encoder import ImageEncoder as ImageEncoder
from rlco.policies.registry import make_policy as make_policy
from rlco.policies.token import TokenPolicy as TokenPolicy
from rlco.policies.value import ValueHead as ValueHead
from rlco.policies.value import ValueNetwork as ValueNetwork
