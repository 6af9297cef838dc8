"""Options that several recipes share: which kind of policy, and what it reads."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal

from rlco.errors import ConfigError, RlcoError
from rlco.files import shown
from rlco.runs.config import RunOptions, option

if TYPE_CHECKING:
    from rlco.data import DemoReplayBuffer
    from rlco.policies import ChunkPolicy

#: What every scene of robosuite's has; it may have others.
USUAL_CAMERAS = {"agentview", "robot0_eye_in_hand"}


def camera_list(text: str) -> list[str]:
    """Return the cameras that an option names.

    Example:
        >>> camera_list("agentview, robot0_eye_in_hand")
        ['agentview', 'robot0_eye_in_hand']
    """
    return [name.strip() for name in text.split(",")]


def camera_names(text: str) -> str | None:
    """Say why a text names no cameras; None where it does.

    Example:
        >>> camera_names("agentview,agentview")
        "'agentview,agentview' is to name one camera or several, each once: A,B"
    """
    names = camera_list(text)
    if all(names) and len(set(names)) == len(names):
        return None
    return f"{text!r} is to name one camera or several, each once: A,B"


@dataclass
class GaussianOptions:
    """Options of policy=gaussian."""

    std: float = option(0.2, "exploration, in units of the normalised action")
    imitation: Literal["nll", "mse"] = option("nll", "imitation loss of a step")


@dataclass
class TokenOptions:
    """Options of policy=token."""

    width: int = option(
        64, "features of a position of the transformer", minimum=1, maximum=1024
    )
    layers: int = option(1, "blocks of the transformer", minimum=1, maximum=32)
    heads: int = option(4, "attention heads; they divide the width", minimum=1)
    bins: int = option(256, "tokens an action number", minimum=2, maximum=2**16)
    bin_range: float = option(
        1.25, "outermost edges of the bins, in units of the normalised action"
    )
    temperature: float = option(1.0, "logits are divided by it")
    noise_std: float = option(
        0.2, "noise on demonstrations, in units of the normalised action", minimum=0
    )
    hidden_share: float = option(
        0.5, "share of chunks imitated from the observation alone", minimum=0, maximum=1
    )
    log_prob_level: Literal["chunk", "action", "token"] = option(
        "chunk", "what one ratio of PPO covers"
    )


@dataclass
class FlowOptions:
    """Options of policy=flow."""

    steps: int = option(4, "denoising steps", minimum=1, maximum=1000)
    method: Literal["flow_noise", "flow_sde", "fpo"] = option(
        "flow_noise", "what stands for the log-probability"
    )
    noisy_steps: Literal["all", "one"] = option("all", "denoising steps with noise")
    noise_range: list[float] = option(
        [0.08, 0.16], "flow_noise: least and greatest standard deviation of a step"
    )
    noise_level: float = option(0.5, "flow_sde: size of the noise")
    denoise_reduction: Literal["mean", "sum"] = option(
        "mean", "of a chain's log-probabilities"
    )
    log_prob_level: Literal["chunk", "action", "token"] = option(
        "chunk", "what one ratio of PPO covers"
    )
    imitation_draws: int = option(1, "times and noises a row", minimum=1, maximum=1000)
    padded_size: int | None = option(
        None, "numbers that RLinf's mean would run over; null: the real ones"
    )


@dataclass
class KindOptions(RunOptions):
    """Which kind of policy is trained, and its options."""

    policy: Literal["gaussian", "token", "flow"] = option("gaussian", "kind of policy")
    gaussian: GaussianOptions = field(default_factory=GaussianOptions)
    token: TokenOptions = field(default_factory=TokenOptions)
    flow: FlowOptions = field(default_factory=FlowOptions)


@dataclass
class AugmentOptions(RunOptions):
    """How images of demonstrations are changed; those of rollouts never are."""

    augment: bool = option(
        False, "shift demonstrations' images, change brightness and contrast"
    )
    augment_shift: float = option(
        0.04, "augment: largest shift, share of the side", minimum=0, maximum=0.25
    )


@dataclass
class PolicyOptions(KindOptions, AugmentOptions):
    """Which kind of policy is trained, and what it reads."""

    image: Literal["none", "conv", "dense", "mobilenet"] = option(
        "none",
        "encoder of images: none, one of rlco's two small ones, or ImageNet's "
        "MobileNetV2",
    )
    image_size: int = option(
        64, "side of the images that it reads [pixels]", minimum=64, maximum=224
    )
    renderer: Literal["raster", "opengl"] = option(
        "raster",
        "what draws the simulator's images: rlco's own renderer, or OpenGL; the "
        "demonstrations' must be the same",
        earlier="opengl",
    )
    camera: str = option(
        "agentview",
        "the simulator's camera whose images it reads, or several: "
        "agentview,robot0_eye_in_hand",
        check=camera_names,
    )
    image_weights: str | None = option(
        None,
        "mobilenet: file of torchvision's weights, mobilenet_v2-b0353104.pth",
        input="file",
    )
    image_frozen: bool = option(True, "mobilenet: leave its weights as they are")
    use_environment_state: bool = option(
        True, "read object poses; false: images alone, as on a robot without them"
    )


def group_values(options: RunOptions, group: type[RunOptions]) -> dict[str, Any]:
    """Return the values of a group of shared options, to pass them on."""
    inner = {entry.name for entry in fields(RunOptions)}
    names = [entry.name for entry in fields(group) if entry.name not in inner]
    return {name: getattr(options, name) for name in names}


def changed(options: RunOptions, *names: str) -> list[str]:
    """Return those of some options that have another value than by default.

    Example:
        >>> changed(AugmentOptions(augment=True), "augment", "augment_shift")
        ['augment=true']
    """
    usual = {entry.name: entry.default for entry in fields(options)}
    values = {name: getattr(options, name) for name in names}
    return [
        f"{name}={str(value).lower() if isinstance(value, bool) else value}"
        for name, value in values.items()
        if value != usual[name]
    ]


def augment(options: AugmentOptions, *sets: DemoReplayBuffer | None) -> None:
    """Let demonstrations be augmented as they are drawn, where the options say so."""
    from rlco.data import Augmentation

    for demos in sets:
        if options.augment and demos is not None:
            demos.augmentation = Augmentation(shift=options.augment_shift)


def check_image_options(options: PolicyOptions) -> None:
    """Check what the options of images say of each other.

    Raises:
        ConfigError: They contradict each other; every problem is reported.
    """
    problems = []
    if options.image == "none":
        problems += [
            f"{given} is of images, and image=none reads none; give image=dense or "
            "image=conv with it, or leave it out"
            for given in changed(options, "camera", "image_size", "image_frozen")
        ]
    if options.image == "none" and not options.use_environment_state:
        problems.append(
            "use_environment_state=false leaves no observation of the objects; "
            "give image=conv, image=dense or image=mobilenet with it"
        )
    if options.image == "none" and options.augment:
        problems.append("augment=true changes images; give image=conv with it")
    if options.image != "mobilenet" and options.image_weights is not None:
        problems.append(
            f"image_weights belongs to image=mobilenet, but image={options.image}"
        )
    if problems:
        raise ConfigError(problems)


def check_rendered(policy: ChunkPolicy, task: str, renderer: str | None = None) -> None:
    """Check that the simulator can render what a policy of a task reads.

    Args:
        policy: The policy.
        task: The task's name.
        renderer: What is to draw it; None: what the policy was trained with.

    Raises:
        RlcoError: The task's environments have no images.
        RenderingError: Nothing can render.
        UnknownNameError: The task's scene has no camera of such a name.
    """
    from rlco.physics.native.stepper import NativeStepper
    from rlco.physics.rendering.camera import camera_id
    from rlco.physics.rendering.renderers import check_can_render
    from rlco.physics.robosuite.options import PREFIX
    from rlco.physics.spec.domain import make_domain
    from rlco.physics.tasks.make_task import make_task

    if policy.image_size is None:
        return
    if task.startswith(PREFIX):
        raise RlcoError(
            f"images are not supported for {task!r}, one of robosuite's own tasks; "
            "give image=none, or one of rlco's tasks."
        )
    drawn = renderer or policy.renderer
    check_can_render(drawn)
    if not set(policy.cameras) <= USUAL_CAMERAS:  # only a scene knows its cameras
        scene = NativeStepper(make_task(task), make_domain("sim"), num_envs=1)
        for name in policy.cameras:
            camera_id(scene.model, name)


def check_look(look: str | None, image_size: object) -> None:
    """Check the name of a look, and that there are images to look so.

    Args:
        look: Its name; None: as the domain says.
        image_size: Of the images that are drawn; None where there are none.

    Raises:
        UnknownNameError: There is no such look.
        ConfigError: There are no images.
    """
    from rlco.physics.spec.looks import make_look

    if look is None:
        return
    make_look(look)
    if image_size is None:
        raise ConfigError(
            [f"look={look} changes images, but none are drawn; leave it out"]
        )


def check_real_camera(camera: str | None, image_size: object) -> None:
    """Check that a camera of real demonstrations is given where images are read.

    Args:
        camera: Its name; None: none is given.
        image_size: Of the images that the policy reads; None where it reads none.

    Raises:
        ConfigError: There are no images.
    """
    if camera is not None and image_size is None:
        raise ConfigError(
            [
                f"real_camera={shown(camera)} names images, but the policy reads none; "
                "leave it out"
            ]
        )


def check_filmed(task: str) -> None:
    """Check that a task can be filmed.

    Raises:
        RlcoError: Its environments have no images.
    """
    from rlco.physics.robosuite.options import PREFIX

    if task.startswith(PREFIX):
        raise RlcoError(
            f"{task!r}, one of robosuite's own tasks, cannot be filmed; give videos=0, "
            "or one of rlco's tasks."
        )


def check_film(policy: ChunkPolicy, renderer: str | None = None) -> None:
    """Check that a policy's film can be drawn.

    Args:
        policy: If it reads images, these are the film; otherwise OpenGL draws it.
        renderer: What is to draw what it reads; None: what it was trained with.

    Raises:
        RenderingError: Nothing can draw it.
    """
    from rlco.physics.rendering.renderers import check_can_render

    drawn = "opengl" if policy.image_size is None else renderer or policy.renderer
    check_can_render(drawn)


def new_policy(options: PolicyOptions, *, task: Any, **sizes: Any) -> ChunkPolicy:
    """Return a new policy of a task, of the kind and the size that the options give.

    Args:
        options: Kind, encoder of images, and what the kind has of its own.
        task: The task: a simulator's, or a `rlco.data.recorded_task.RecordedTask`.
        **sizes: What else its constructor takes.

    Raises:
        ConfigError: An option that the policy cannot have.
        CheckpointError: The weights of its image encoder cannot be loaded.
    """
    from rlco.policies import make_policy, task_sizes

    read = task_sizes(task)
    if not options.use_environment_state:
        read["environment_state_size"] = 0
    policy: ChunkPolicy = make_policy(
        options.policy,
        action_size=len(task.action_names),
        action_limit=task.action_limit,
        image=_image_arguments(options),
        **sizes,
        **read,
        **asdict(getattr(options, options.policy)),
    )
    return policy


def _image_arguments(options: PolicyOptions) -> Any:
    """Return the encoder of images, as a policy's constructor takes it; None: none."""
    if options.image == "none":
        return None
    size = (options.image_size, options.image_size)
    cameras = camera_list(options.camera)
    shared: dict[str, Any] = {"size": size, "renderer": options.renderer}
    # One alone is recorded as it always was.
    shared |= {"camera": cameras[0]} if len(cameras) == 1 else {"cameras": cameras}
    if options.image != "mobilenet":
        return {"kind": options.image, **shared}
    return {
        "kind": "mobilenet",
        **shared,
        "weights": options.image_weights,
        "frozen": options.image_frozen,
    }
