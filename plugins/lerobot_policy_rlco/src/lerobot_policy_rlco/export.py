"""A policy folder of rlco as a checkpoint folder of LeRobot."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.factory import make_pre_post_processors
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from lerobot_policy_rlco.configuration_rlco import RlcoConfig
from lerobot_policy_rlco.modeling_rlco import RlcoPolicy
from rlco.errors import ConfigError, OutputExistsError, RlcoError
from rlco.policies import load_policy


def export_policy(
    policy: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    executed: int | None = None,
    camera: str = "front",
) -> Path:
    """Write a policy that rlco trained as a checkpoint of the type ``rlco``.

    Args:
        policy: the folder that a recipe saved.
        folder: where to; it must not exist.
        executed: steps of a chunk that are executed before the next; None: all.
        camera: last part of LeRobot's name for the camera, where the policy has one:
            ``front`` for ``observation.images.front``; of several ``front,wrist``, in
            the order of the policy's cameras.

    Returns:
        The folder, for ``--policy.path``.

    Raises:
        CheckpointError: the policy cannot be read.
        ConfigError: as many cameras as the policy reads are not named.
        OutputExistsError: the folder exists.
    """
    path = Path(folder)
    if path.exists():
        raise OutputExistsError(path)
    actor, extra = load_policy(policy)
    arguments: dict[str, Any] = actor.arguments
    inputs = {OBS_STATE: PolicyFeature(FeatureType.STATE, (arguments["state_size"],))}
    if size := arguments["environment_state_size"]:
        inputs[OBS_ENV_STATE] = PolicyFeature(FeatureType.ENV, (size,))
    if image := arguments.get("image"):
        shape = (3, *image["size"])
        for name in _names(camera, actor.cameras):
            inputs[f"{OBS_IMAGES}.{name}"] = PolicyFeature(FeatureType.VISUAL, shape)
    action = PolicyFeature(FeatureType.ACTION, (arguments["action_size"],))
    config = RlcoConfig(
        kind=actor.kind,
        arguments=json.dumps(arguments),
        instructions=list(extra.get("instructions", [])),
        n_action_steps=executed or arguments["chunk"],
        input_features=inputs,
        output_features={ACTION: action},
        device="cpu",
        push_to_hub=False,
    )
    exported = RlcoPolicy(config)
    exported.actor.load_state_dict(actor.state_dict())
    exported.save_pretrained(path)
    for processor in make_pre_post_processors(config):
        processor.save_pretrained(path)
    return path


def _names(camera: str, cameras: Sequence[str]) -> list[str]:
    names = camera.split(",")
    if len(names) != len(cameras) or len(set(names)) < len(names):
        raise ConfigError(
            [
                f"the policy reads {len(cameras)} cameras, {', '.join(cameras)}, but "
                f"CAMERA is {camera}; give a name for each, in this order"
            ]
        )
    return names


def next_command(
    policy: str | os.PathLike[str], folder: Path, *, camera: str = "front"
) -> str:
    """Return the command of LeRobot's that runs an exported policy.

    In the simulator that it was trained for; on the robot where there is none.

    Args:
        policy: the folder that a recipe saved.
        folder: what `export_policy` returned.
        camera: as it was exported.
    """
    actor, extra = load_policy(policy)
    if extra.get("task") is not None:
        words = ["lerobot-eval", "--env.type=rlco", f"--env.task={extra['task']}"]
        words += [f"--env.camera={camera}"] if actor.image_size else []
        if len(actor.cameras) > 1:
            words.append(f"--env.cameras={','.join(actor.cameras)}")
        if actor.image_size and actor.renderer != "opengl":
            words.append(f"--env.renderer={actor.renderer}")
    else:
        words = ["lerobot-rollout", "--robot.type=ROBOT"]
        if actor.image_size:
            given = ", ".join(f"{name}: ..." for name in camera.split(","))
            words.append(f"--robot.cameras={{{given}}}")
        if rate := extra.get("control_frequency"):
            words.append(f"--fps={rate:g}")
        if texts := extra.get("instructions"):
            words.append(f"--task={texts[0]}")
    words.insert(1, f"--policy.path={folder}")
    return shlex.join(words)


def main() -> None:
    """Run ``rlco-to-lerobot POLICY FOLDER [CAMERA]``."""
    if len(sys.argv) not in (3, 4):
        sys.exit("usage: rlco-to-lerobot POLICY FOLDER [CAMERA]")
    policy, folder, *camera = sys.argv[1:]
    try:
        seen = camera[0] if camera else "front"
        path = export_policy(policy, folder, camera=seen)
        command = next_command(policy, path, camera=seen)
    except RlcoError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(2)
    sys.stdout.write(f"{command}\n")
