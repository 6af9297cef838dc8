"""What acts: policies on TensorDicts, their value network, and their checkpoints."""

from rlco.policies.actor import Actor as Actor
from rlco.policies.actor import Imitation as Imitation
from rlco.policies.checkpoint import load_policy as load_policy
from rlco.policies.checkpoint import load_weights as load_weights
from rlco.policies.checkpoint import save_policy as save_policy
from rlco.policies.gaussian import GaussianPolicy as GaussianPolicy
from rlco.policies.registry import make_policy as make_policy
from rlco.policies.value import ValueNetwork as ValueNetwork
