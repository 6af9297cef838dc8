"""Every TensorDict key of rlco, once, as plain tuples and strings.

TorchRL's VLA schema (``torchrl.data.vla.schema``) supplies the name wherever it
has one; the rest follows LeRobot's words. This module imports no torch, so that
every layer may use it.

Axes: ``B`` a batch of decisions, ``N`` environments, ``T`` decisions in time,
``H`` the steps of an action chunk, ``A`` action numbers (7: delta position 3,
delta rotation 3, gripper 1, each in [-1, 1]), ``S`` and ``E`` features.
"""

from __future__ import annotations

from collections.abc import Sequence

# -- What the policy observes --------------------------------------------------
OBSERVATION = "observation"
#: Robot proprioception, float32 [*B, S], in the units that the task's
#: ``state_names`` give (metres, radians).
STATE = ("observation", "state")
#: Object and goal positions as the camera would report them, float32 [*B, E], [m].
ENVIRONMENT_STATE = ("observation", "environment_state")
#: One camera frame, uint8 [*B, C, H, W]; absent where there is no camera. Several
#: cameras have one each under it, see `image_keys`.
IMAGE = ("observation", "image")
#: What a fixed encoder of a policy makes of these, float32 [*B, F]: computed once.
IMAGE_FEATURES = ("observation", "image_features")
#: Share of the episode that is left, float32 [*B, 1], 1 as it starts and 0 as it ends.
#: For critics: a policy does not read it, and a robot has none.
TIME_LEFT = ("observation", "time_left")
#: The instruction as text: a non-tensor at the root, one string a row.
INSTRUCTION = "language_instruction"
#: The instruction as its index in the task's list of instructions, int64 [*B].
#: Losses read this one: strings break torch.compile.
INSTRUCTION_ID = "instruction_id"
#: The domain that a row is from, float32 [*B, 1]: +1 real, -1 sim (`DOMAIN_FLAGS`), 0
#: where it is not said. For policies with a domain flag, which take a batch without it
#: as real.
DOMAIN = "domain"


def image_keys(cameras: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Return the keys of cameras' frames: one alone has no name.

    Example:
        >>> image_keys(["agentview"])
        (('observation', 'image'),)
        >>> image_keys(["agentview", "wrist"])[1]
        ('observation', 'image', 'wrist')
    """
    if len(cameras) == 1:
        return (IMAGE,)
    return tuple((*IMAGE, name) for name in cameras)


def is_image(key: object) -> bool:
    """Return whether a key is one of a camera's frames.

    Example:
        >>> is_image(IMAGE), is_image((*IMAGE, "wrist")), is_image("action")
        (True, True, False)
    """
    return isinstance(key, tuple) and key[: len(IMAGE)] == IMAGE


# -- What it outputs -----------------------------------------------------------
#: What the environment executes, float32: [*B, A], or [*B, H, A] with chunks.
ACTION = "action"
#: The demonstrated (or executed) action chunk, raw units, float32 [*B, H, A].
CHUNK = ("vla_action", "chunk")
#: The policy's own sample whose log-probability PPO recomputes; its shape and
#: units belong to the policy. Gaussian: normalised chunk [*B, H, A]; token: int64
#: [*B, H, A]; flow: the denoising chain [*B, K + 1, H, A], noise first.
SAMPLE = ("vla_action", "sample")
#: Log-probability of one decision's sample in the normalised action space, [*B].
LOG_PROB = ("vla_action", "log_probs")
#: Flow, one noisy step a decision: its index, int64 [*B].
DENOISE_STEP = ("vla_action", "denoise_step")
#: Flow, FPO: the times [*B, D] and noises [*B, D, H, A] at which losses are compared.
FLOW_TIME = ("vla_action", "flow_time")
FLOW_NOISE = ("vla_action", "flow_noise")
#: True where a chunk reaches past its episode's end, bool [*B, H]. Padded steps
#: repeat the last action and count in no loss.
IS_PAD = "action_is_pad"

# -- What the environment returns ----------------------------------------------
#: Sum of the rewards of the executed control steps, float32 [*B, 1].
REWARD = "reward"
DONE = "done"
TERMINATED = "terminated"
TRUNCATED = "truncated"
#: Whether the task is solved in this very state, bool [*B, 1].
SUCCESS = "success"
#: Whether the simulation broke in this decision, bool [*B, 1]: the observation is the
#: last sound one, the reward 0, and the episode truncated.
DIVERGED = "diverged"

# -- What the learner adds -----------------------------------------------------
ADVANTAGE = "advantage"  # float32 [*B, 1]
VALUE_TARGET = "value_target"  # float32 [*B, 1]
STATE_VALUE = "state_value"  # float32 [*B, 1]

# -- The two roots of a training batch -----------------------------------------
SIM = "sim"
REAL = "real"
#: `DOMAIN` of a root's rows.
DOMAIN_FLAGS = {SIM: -1.0, REAL: 1.0}
