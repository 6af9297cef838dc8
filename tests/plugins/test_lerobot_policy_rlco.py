"""rlco's small policies behind LeRobot's interface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot_policy_rlco.export import export_policy, main
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco.data.resize import resized
from rlco.errors import ConfigError, DataError, OutputExistsError
from rlco.policies import make_policy, save_policy

INSTRUCTIONS = ["push the red cube", "push the blue cube"]
KINDS = ("gaussian", "token", "flow")


def trained(kind: str) -> Any:
    torch.manual_seed(0)
    policy = make_policy(
        kind,
        state_size=3,
        environment_state_size=2,
        num_instructions=2,
        chunk=4,
        action_size=7,
        hidden=(16,),
    )
    for parameter in policy.parameters():
        torch.nn.init.normal_(parameter, 0.0, 0.3)
    policy.set_normalization(state=([-2.0] * 3, [3.0] * 3))
    return policy


def with_images(folder: Path, camera: str, *views: str) -> tuple[Any, Any, Path]:
    """Return a policy that reads images, the same behind LeRobot, and its folder."""
    torch.manual_seed(0)
    image: Any = {"kind": "conv", "size": (64, 64)}
    if views:
        image["cameras"] = views
    policy = make_policy(
        "gaussian",
        image=image,
        state_size=3,
        num_instructions=2,
        chunk=4,
        hidden=(16,),
    )
    for parameter in policy.parameters():
        torch.nn.init.normal_(parameter, 0.0, 0.3)
    save_policy(policy, folder / "ours", extra={"instructions": INSTRUCTIONS})
    path = export_policy(folder / "ours", folder / "theirs", camera=camera)
    config = PreTrainedConfig.from_pretrained(path)
    theirs = get_policy_class("rlco").from_pretrained(path, config=config)
    return policy, theirs, path


@pytest.fixture
def exported(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Any, Path]:
    policy = trained(getattr(request, "param", "gaussian"))
    save_policy(policy, tmp_path / "ours", extra={"instructions": INSTRUCTIONS})
    path = export_policy(tmp_path / "ours", tmp_path / "theirs", executed=2)
    return policy, path


def batch(count: int = 3) -> dict[str, Any]:
    torch.manual_seed(1)
    return {
        "observation.state": torch.randn(count, 3),
        "observation.environment_state": torch.randn(count, 2),
        "task": [INSTRUCTIONS[i % 2] for i in range(count)],
    }


@pytest.mark.parametrize("exported", KINDS, indirect=True)
def test_lerobot_acts_as_the_policy_does(exported: tuple[Any, Path]) -> None:
    policy, path = exported
    config = PreTrainedConfig.from_pretrained(path)
    assert config.type == "rlco"
    theirs = get_policy_class("rlco").from_pretrained(path, config=config)
    pre, post = make_pre_post_processors(config, pretrained_path=str(path))
    given = batch()
    td = TensorDict(
        {
            "observation": {
                "state": given["observation.state"],
                "environment_state": given["observation.environment_state"],
            },
            "instruction_id": torch.tensor([0, 1, 0]),
        },
        [3],
    )
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        expected = policy(td)["action"]
    # Two steps of each chunk are executed, then the next chunk begins.
    seen = [post(theirs.select_action(pre(batch()))) for _ in range(3)]
    for step, action in zip((0, 1, 0), seen, strict=True):
        torch.testing.assert_close(action, expected[:, step])
    theirs.select_action(pre(batch()))
    theirs.select_action(pre(batch()))
    theirs.reset()
    torch.testing.assert_close(post(theirs.select_action(pre(batch()))), expected[:, 0])


def test_lerobot_trains_it_by_imitation(exported: tuple[Any, Path]) -> None:
    policy, path = exported
    config = PreTrainedConfig.from_pretrained(path)
    theirs = get_policy_class("rlco").from_pretrained(path, config=config)
    assert config.action_delta_indices == [0, 1, 2, 3]
    given = batch() | {
        "action": torch.rand(3, 4, 7),
        "action_is_pad": torch.tensor([[False, False, True, True]] * 3),
    }
    loss, _ = theirs.forward(given)
    rows = theirs._rows(given)
    steps = policy.imitation_loss(rows)
    torch.testing.assert_close(loss, steps[:, :2].mean())
    loss.backward()
    assert any(p.grad is not None for p in theirs.get_optim_params())


def test_lerobot_weighs_frames_by_their_own_loss(exported: tuple[Any, Path]) -> None:
    policy, path = exported
    config = PreTrainedConfig.from_pretrained(path)
    theirs = get_policy_class("rlco").from_pretrained(path, config=config)
    given = batch() | {"action": torch.rand(3, 4, 7)}
    steps = policy.imitation_loss(theirs._rows(given))
    loss, _ = theirs.forward(given, reduction="none")
    torch.testing.assert_close(loss, steps.mean(1))
    pad = torch.tensor([[False] * 4, [False, True, True, True], [True] * 4])
    loss, told = theirs.forward(given | {"action_is_pad": pad}, reduction="none")
    expected = torch.stack([steps[0].mean(), steps[1, 0], torch.tensor(0.0)])
    torch.testing.assert_close(loss, expected)
    assert told["loss_bc"] == pytest.approx(float(expected.mean()))
    with pytest.raises(ConfigError, match="reduction='sum' is neither"):
        theirs.forward(given, reduction="sum")


def test_a_text_that_was_never_trained_is_refused(exported: tuple[Any, Path]) -> None:
    _, path = exported
    config = PreTrainedConfig.from_pretrained(path)
    theirs = get_policy_class("rlco").from_pretrained(path, config=config)
    given = batch() | {"task": ["push the red cub"] * 3}
    with pytest.raises(DataError, match="did you mean 'push the red cube'"):
        theirs.select_action(given)


def test_a_robot_that_does_not_see_the_objects_is_told_so(
    exported: tuple[Any, Path],
) -> None:
    _, path = exported
    config = PreTrainedConfig.from_pretrained(path)
    theirs = get_policy_class("rlco").from_pretrained(path, config=config)
    given = batch()
    del given["observation.environment_state"]
    with pytest.raises(
        DataError, match=r"reads observation.environment_state.*gives observation.state"
    ):
        theirs.select_action(given)


@pytest.mark.parametrize(
    ("extra", "image", "command"),
    [
        (
            {"task": None, "control_frequency": 30, "instructions": ["sort it"]},
            None,
            "lerobot-rollout --policy.path=OUT --robot.type=ROBOT --fps=30 "
            "'--task=sort it'",
        ),
        (
            {"task": None, "control_frequency": 12.5, "instructions": []},
            {"kind": "conv", "size": (64, 64)},
            "lerobot-rollout --policy.path=OUT --robot.type=ROBOT "
            "'--robot.cameras={wrist: ...}' --fps=12.5",
        ),
        (
            {"task": "open_drawer"},
            {"kind": "conv", "size": (64, 64)},
            "lerobot-eval --policy.path=OUT --env.type=rlco --env.task=open_drawer "
            "--env.camera=wrist",
        ),
    ],
)
def test_the_command_that_follows_runs_it_where_it_can_run(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    extra: dict[str, Any],
    image: Any,
    command: str,
) -> None:
    policy = make_policy("gaussian", state_size=3, chunk=4, hidden=(4,), image=image)
    save_policy(policy, tmp_path / "ours", extra=extra)
    out = tmp_path / "theirs"
    words = ["rlco-to-lerobot", str(tmp_path / "ours"), str(out), "wrist"]
    monkeypatch.setattr("sys.argv", words)
    main()
    said = capsys.readouterr().out.strip().splitlines()[-1]
    assert said == command.replace("OUT", str(out))


def test_a_policy_that_sees_reads_lerobots_camera(tmp_path: Path) -> None:
    policy, theirs, path = with_images(tmp_path, "wrist")
    pre, post = make_pre_post_processors(theirs.config, pretrained_path=str(path))
    pixels = torch.randint(256, (2, 3, 64, 64), dtype=torch.uint8)
    state = torch.randn(2, 3)
    td = TensorDict(
        {
            "observation": {"state": state, "image": pixels},
            "instruction_id": torch.tensor([1, 0]),
        },
        [2],
    )
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        expected = policy(td)["action"]
    given = {
        "observation.state": state,
        "observation.images.wrist": pixels.float() / 255,
        "task": INSTRUCTIONS[::-1],
    }
    torch.testing.assert_close(post(theirs.select_action(pre(given))), expected[:, 0])


def test_each_of_several_cameras_is_read_by_its_own_encoder(tmp_path: Path) -> None:
    views = ("agentview", "robot0_eye_in_hand")
    policy, theirs, _ = with_images(tmp_path, "front,wrist", *views)
    front, wrist = torch.randint(256, (2, 1, 3, 64, 64), dtype=torch.uint8)
    state = torch.randn(1, 3)
    images = dict(zip(views, (front, wrist), strict=True))
    td = TensorDict({"instruction_id": torch.tensor([1])}, [1])
    td["observation"] = {"state": state, "image": images}
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        expected = policy(td)["action"]

    def chunk(front: torch.Tensor, wrist: torch.Tensor) -> torch.Tensor:
        given = {"observation.state": state, "task": INSTRUCTIONS[1:]}
        frames = {"front": front, "wrist": wrist}
        given |= {f"observation.images.{k}": v.float() / 255 for k, v in frames.items()}
        return theirs.predict_action_chunk(given)

    torch.testing.assert_close(chunk(front, wrist), expected)
    assert not torch.allclose(chunk(wrist, front), expected)


def test_a_robots_larger_frames_are_cut_and_shrunk_as_in_training(
    tmp_path: Path,
) -> None:
    _, theirs, _ = with_images(tmp_path, "front")
    # A square in the middle of a wide frame, in blocks of 4 x 4 pixels of one colour.
    small = torch.randint(256, (1, 3, 64, 64), dtype=torch.uint8)
    square = small.repeat_interleave(4, -2).repeat_interleave(4, -1)
    wide = torch.nn.functional.pad(square, (40, 40))
    batch = {"observation.state": torch.randn(1, 3), "task": INSTRUCTIONS[:1]}

    def chunk(pixels: torch.Tensor) -> torch.Tensor:
        frames = {"observation.images.front": pixels.float() / 255}
        return theirs.predict_action_chunk(batch | frames)

    torch.testing.assert_close(chunk(wide), chunk(resized(wide, (64, 64))))
    assert not torch.allclose(chunk(wide), chunk(wide[..., :64, :64]))
    with pytest.raises(DataError, match=r"front gives frames of 32 x 96.*64 x 64"):
        chunk(wide[..., :32, :96])


def test_an_exported_policy_is_not_overwritten(exported: tuple[Any, Path]) -> None:
    _, path = exported
    with pytest.raises(OutputExistsError):
        export_policy(path.parent / "ours", path)
