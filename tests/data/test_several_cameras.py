"""Several cameras: recorded, read back, and read by a policy."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from rlco.data import Augmentation, DemoWriter, load_demos, load_task_demos
from rlco.data.expert_demos import record_demonstrations
from rlco.envs import make_env
from rlco.errors import ConfigError, DataError
from rlco.keys import ACTION, IMAGE, STATE
from rlco.physics.tasks.push_cube import TASK
from rlco.policies import GaussianPolicy, load_policy, save_policy

CAMERAS = ["agentview", "robot0_eye_in_hand"]
KEYS = [(*IMAGE, name) for name in CAMERAS]
SIZE = (64, 64)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a data set of one episode by two cameras in random looks."""
    path = tmp_path_factory.mktemp("cameras") / "demos"
    record_demonstrations(
        path,
        "push_cube",
        "sim",
        episodes=1,
        seed=3,
        camera=CAMERAS,
        image_size=64,
        renderer="raster",
        look="random",
    )
    return path


@pytest.mark.slow
def test_what_was_recorded_is_what_the_environment_shows(recorded: Path) -> None:
    cameras = {name: f"observation.images.{name}" for name in CAMERAS}
    rows = load_demos(recorded, image_key=cameras).frames()
    env = make_env(
        "push_cube",
        image_size=SIZE,
        cameras=CAMERAS,
        renderer="raster",
        look="random",
        seed=3,
    )
    # In sim the robot's state has no noise: it says which episode it is.
    starts = make_env("push_cube", num_envs=20, seed=3).reset()[STATE]
    ((episode,),) = (starts == rows[STATE][0]).all(-1).nonzero().tolist()
    env.start_at(episode)
    td = env.reset()
    for row in range(5):
        for key in KEYS:
            # PNG keeps bytes; actions are kept in 32 bits, so that later states differ
            # by a rounding, and hardly a byte.
            same = rows[key][row] == td[key][0]
            assert same.all() if row == 0 else same.float().mean() > 0.99
        action = rows[ACTION][row].view(1, 1, 7)
        td = env.step(TensorDict({ACTION: action}, [1]))["next"]
    said = json.loads((recorded / "meta" / "rlco.json").read_text())
    assert said == {
        "task": "push_cube",
        "domain": "sim",
        "seed": 3,
        "noise": 0.1,
        "renderer": "raster",
        "cameras": CAMERAS,
        "look": "random",
    }
    assert load_demos(recorded, image_key=False).meta.recorded == said


@pytest.mark.slow
def test_cameras_of_a_data_set_take_the_policys_names(recorded: Path) -> None:
    given = {"chunk": 2, "image_size": SIZE, "cameras": ["front", "hand"]}
    demos = load_task_demos(recorded, TASK, camera=",".join(CAMERAS), **given)
    plain = load_task_demos(recorded, TASK, chunk=2, image_size=SIZE, cameras=CAMERAS)
    for ours, theirs in zip(("front", "hand"), KEYS, strict=True):
        assert torch.equal(demos.frames()[(*IMAGE, ours)], plain.frames()[theirs])
    with pytest.raises(DataError, match=r"2 cameras are read, front, hand.*names 1"):
        load_task_demos(recorded, TASK, camera="agentview", **given)
    with pytest.raises(DataError, match="has no camera 'front'"):
        load_task_demos(recorded, TASK, **given)


@pytest.mark.slow
def test_images_of_every_camera_are_augmented(recorded: Path) -> None:
    demos = load_task_demos(recorded, TASK, chunk=2, image_size=SIZE, cameras=CAMERAS)
    demos.augmentation = Augmentation()
    rows, stored = demos.sample(4), demos.frames()
    for key in KEYS:
        for row in range(4):
            kept = stored[key][int(rows["frame"][row])]
            assert not torch.equal(rows[key][row], kept)


def frames(count: int) -> TensorDict:
    torch.manual_seed(0)
    images = {
        key: torch.randint(0, 256, (count, 3, *SIZE), dtype=torch.uint8) for key in KEYS
    }
    state = torch.rand(count, 7)
    return TensorDict({("observation", "state"): state, **images}, [count])


def seeing(cameras: list[str]) -> GaussianPolicy:
    torch.manual_seed(1)
    image = {"kind": "conv", "size": SIZE, "cameras": cameras}
    return GaussianPolicy(7, chunk=2, image=image)


def test_a_policy_reads_each_camera_by_an_encoder_of_its_own(tmp_path: Path) -> None:
    policy, rows = seeing(CAMERAS), frames(2)
    assert policy.cameras == tuple(CAMERAS)
    assert [key for key in policy.in_keys if key in KEYS] == KEYS
    features = policy.encoder(rows)
    for key in KEYS:  # each of them counts
        other = rows.clone().set(key, 255 - rows[key])
        assert (policy.encoder(other) != features).any()
    swapped = rows.clone().set(KEYS[0], rows[KEYS[1]]).set(KEYS[1], rows[KEYS[0]])
    assert (policy.encoder(swapped) != features).any()
    save_policy(policy, tmp_path / "policy", extra={})
    loaded, _ = load_policy(tmp_path / "policy")
    assert loaded.cameras == policy.cameras
    assert torch.equal(loaded.encoder(rows), features)


def test_one_camera_of_a_list_is_read_under_the_key_without_a_name() -> None:
    policy = seeing(["frontview"])
    assert policy.cameras == ("frontview",)
    assert IMAGE in policy.in_keys


def test_cameras_that_cannot_be_are_refused(tmp_path: Path) -> None:
    for cameras in ([], ["agentview", "agentview"]):
        with pytest.raises(ConfigError, match="must be at least one, each once"):
            seeing(cameras)
    names = {"state_names": ["a"], "action_names": ["b"]}
    with pytest.raises(ConfigError, match="must all be different"):
        DemoWriter(
            tmp_path / "set", fps=20, camera=["a", "a"], image_size=SIZE, **names
        )


@pytest.mark.slow
def test_a_frame_of_each_camera_is_asked_for(tmp_path: Path) -> None:
    names = {"state_names": ["a"], "action_names": ["b"]}
    image = np.zeros((3, *SIZE), np.uint8)
    given = {"state": [0.0], "action": [0.0], "task": "go"}
    writer = DemoWriter(
        tmp_path / "set", fps=20, camera=CAMERAS, image_size=SIZE, **names
    )
    for wrong in (image, {"agentview": image}):
        with pytest.raises(DataError, match="an image of each of the cameras"):
            writer.add_frame(image=wrong, **given)
    with pytest.raises(DataError, match="image is not given"):
        writer.add_frame(**given)
