"""Stage II on a LeRobot checkpoint: what moves, what is refused, what is resumed."""

from __future__ import annotations

import csv
import importlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from recipe_cases import refused, start
from safetensors.torch import load_file, save_file
from tensordict import TensorDict, TensorDictBase

from rlco.data import DemoWriter
from rlco.errors import CheckpointError, NonFiniteError, RenderingError
from rlco.physics.rendering import renderers
from rlco.physics.spec.names import ACTION_NAMES, STATE_NAMES
from rlco.policies.tiny.smolvla import write_tiny_smolvla
from rlco.policies.vla.lerobot.inputs import dataset_stats
from rlco.policies.vla.prefix_critic import PrefixCritic
from rlco.runs.resumed import inputs_of

pytestmark = pytest.mark.slow

RECIPE = "lerobot_co_train"
LAST = "lerobot/checkpoints/last/pretrained_model"


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_smolvla(tmp_path_factory.mktemp("tiny"))


def configured(tiny: Path, **options: Any) -> Any:
    """Return the recipe and its options."""
    recipe: Any = importlib.import_module(RECIPE)
    return recipe, recipe.Config(policy=str(tiny), real_coeff=0.0, **options)


def test_the_folder_of_statistics_is_an_input(tmp_path: Path) -> None:
    (tmp_path / "stats.json").write_text("{}")
    _, config = configured(tmp_path, stats=str(tmp_path))
    assert {"policy", "stats"} <= inputs_of(config).keys()


def made(recipe: Any, config: Any, policy: Any) -> Any:
    """Return the recipe's learner with a critic and no anchor, for four decisions."""
    critic = PrefixCritic(policy.model.summary_size)
    return recipe.make_learner(config, policy, critic, None, 4)


def rollout(policy: Any, critic: Any = None, count: int = 4) -> TensorDictBase:
    """Return decisions with advantages, as the collector would."""
    torch.manual_seed(0)
    td = TensorDict(
        {
            "observation": {
                "state": torch.rand(count, 7) * 2 - 1,
                "image": torch.randint(256, (count, 3, 64, 64), dtype=torch.uint8),
            },
            "instruction_id": torch.arange(count) % 2,
        },
        [count],
    )
    td = policy(td)
    td["advantage"] = torch.linspace(-1, 1, count).unsqueeze(-1)
    if critic is not None:
        with torch.no_grad():
            td = critic(td)
        td["value_target"] = td["state_value"] + 1
    return td


def copies(module: torch.nn.Module) -> list[torch.Tensor]:
    return [parameter.detach().clone() for parameter in module.parameters()]


def furthest(before: list[torch.Tensor], module: torch.nn.Module) -> float:
    """Return how far the parameter went that went furthest."""
    pairs = zip(before, module.parameters(), strict=True)
    return max(float((a - b).detach().abs().max()) for a, b in pairs)


# -- What moves --------------------------------------------------------------------


@pytest.mark.parametrize("train_policy", [False, True])
def test_noise_moves_when_the_policy_does(tiny: Path, train_policy: bool) -> None:
    recipe, config = configured(tiny, lr=1e-3, minibatch=2, accumulate=2)
    _, policy, _ = recipe.load(config)
    learner = made(recipe, config, policy)
    parts = {
        "critic": learner.critic,
        "noise": policy.noise,
        "expert": policy.policy.model.vlm_with_expert.lm_expert,
        "vlm": policy.policy.model.vlm_with_expert.vlm,
    }
    before = {name: copies(part) for name, part in parts.items()}
    learner.update(rollout(policy, learner.critic), 1, train_policy=train_policy)
    moved = {name for name, part in parts.items() if furthest(before[name], part) > 0}
    assert moved == {"critic"} | ({"noise", "expert"} if train_policy else set())


def test_the_noises_gradient_is_clipped_with_the_policys(tiny: Path) -> None:
    far = []
    for limit in (1.0, 1e-14):
        recipe, config = configured(tiny, minibatch=4, max_grad_norm=limit)
        _, policy, _ = recipe.load(config)
        learner = made(recipe, config, policy)
        before = copies(policy.noise)
        learner.update(rollout(policy, learner.critic), 1)
        far.append(furthest(before, policy.noise))
    # Adam's first step is the learning rate, however small the gradient, until its
    # epsilon of 1e-8 is the larger one.
    assert far[0] == pytest.approx(2e-4, rel=0.1)
    assert far[1] < 1e-8


def test_weights_of_16_bits_move_by_small_steps_too(tiny: Path) -> None:
    recipe, config = configured(tiny, minibatch=4, accumulate=1, lr=4e-6)
    _, policy, _ = recipe.load(config)
    expert = policy.policy.model.vlm_with_expert.lm_expert.bfloat16()
    policy.policy.model.vlm_with_expert.vlm.bfloat16()
    learner = made(recipe, config, policy)
    learner.update(rollout(policy, learner.critic), 1)
    gone = [
        float((learner.actor_optimizer.state[p]["master"] - p).abs().max())
        for p in expert.parameters()
        if p in learner.actor_optimizer.state
    ]
    # What bfloat16 could not hold is kept beside it.
    assert max(gone) == pytest.approx(4e-6, rel=0.5)


def test_minibatches_together_make_one_update(tiny: Path) -> None:
    steps = []
    for minibatch, accumulate in ((4, 1), (2, 2), (2, 4)):
        recipe, config = configured(
            tiny, minibatch=minibatch, accumulate=accumulate, max_grad_norm=1e9
        )
        _, policy, _ = recipe.load(config)
        learner = made(recipe, config, policy)
        learner.critic_optimizer = torch.optim.SGD(policy.noise.parameters(), lr=1.0)
        before = copies(policy.noise)
        learner.update(rollout(policy, learner.critic), 1)
        pairs = zip(policy.noise.parameters(), before, strict=True)
        steps.append(torch.cat([(a - b).detach().flatten() for a, b in pairs]))
    assert float(steps[0].abs().max()) > 1e-5
    # Two halves of a batch are the batch.
    torch.testing.assert_close(steps[1], steps[0], atol=1e-7, rtol=1e-3)
    # What is left at the end of a rollout is followed too, at its own share.
    torch.testing.assert_close(steps[2], steps[0] / 2, atol=1e-7, rtol=1e-3)


def test_no_step_follows_gradients_of_which_one_minibatchs_is_not_finite(
    tiny: Path,
) -> None:
    recipe, config = configured(tiny, minibatch=1, accumulate=2, critic_lr=1e-3)
    _, policy, _ = recipe.load(config)
    learner = made(recipe, config, policy)
    td = rollout(policy, learner.critic)
    td["value_target"][2] = torch.nan
    before = copies(policy), copies(learner.critic)
    with pytest.raises(NonFiniteError, match="loss_critic became nan in update "):
        learner.update(td, 1)
    for old, part in zip(before, (policy, learner.critic), strict=True):
        assert furthest(old, part) < 1e-2  # NaN would be no less
    assert all(bool(p.isfinite().all()) for p in policy.parameters())


def test_training_that_diverges_leaves_no_checkpoint_behind(
    tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["config=debug", f"policy={tiny}", "real_coeff=0", "eval_episodes=0"]
    given += ["horizon=8", "lr=1e36", "critic_iterations=1", "iterations=2"]
    given += ["minibatch=1", "accumulate=1", f"out={tmp_path / 'run'}"]
    with pytest.raises(SystemExit) as caught:
        start(RECIPE, *given)
    assert caught.value.code == 2
    assert "lower lr" in capsys.readouterr().err
    (kept,) = (tmp_path / "run" / "checkpoints").iterdir()
    assert kept.name == "step_0000001.safetensors"
    assert not (tmp_path / "run" / "lerobot").exists()


@pytest.mark.parametrize(
    ("options", "moved", "rested"),
    [
        (["trained=lora", "lora_rank=2"], ".lm_expert.", "action_out_proj.bias"),
        (["trained=full"], "state_proj.", ".vlm."),
        (["method=flow_sde", "noisy_steps=one"], ".lm_expert.", "state_proj."),
    ],
)
def test_each_way_to_train_starts_at_ratio_one(
    tiny: Path, tmp_path: Path, options: list[str], moved: str, rested: str
) -> None:
    given = ["config=debug", f"policy={tiny}", "real_coeff=0", "eval_episodes=0"]
    given += ["horizon=8", "lr=1e-3", "iterations=1", f"out={tmp_path / 'run'}"]
    start(RECIPE, *given, *options)
    (row,) = (r for r in told(tmp_path / "run") if r["first_ratio"])
    assert float(row["first_ratio"]) == pytest.approx(1, abs=1e-5)
    before = load_file(tiny / "model.safetensors")
    after = load_file(tmp_path / "run" / LAST / "model.safetensors")
    assert before.keys() == after.keys()
    changed = {name for name in before if not torch.equal(before[name], after[name])}
    assert any(moved in name for name in changed)
    assert not any(rested in name for name in changed)


def told(run: Path) -> list[dict[str, str]]:
    with (run / "metrics.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.thorough
@pytest.mark.parametrize("options", [[], ["trained=lora", "lora_rank=2"]])
def test_a_resumed_run_equals_an_uninterrupted_one(
    tiny: Path, tmp_path: Path, options: list[str]
) -> None:
    given = ["config=debug", f"policy={tiny}", "real_coeff=0", "eval_episodes=0"]
    given += ["horizon=8", "lr=1e-3", *options]
    whole, part = tmp_path / "whole", tmp_path / "part"
    start(RECIPE, *given, "iterations=2", f"out={whole}")
    start(RECIPE, *given, "iterations=1", f"out={part}")
    start(RECIPE, f"resume={part}", "iterations=2")
    metrics = [(path / "metrics.csv").read_bytes() for path in (whole, part)]
    assert metrics[0] == metrics[1]
    weights = [load_file(path / LAST / "model.safetensors") for path in (whole, part)]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])
    start_weights = load_file(tiny / "model.safetensors")
    assert any(not torch.equal(v, weights[0][k]) for k, v in start_weights.items())
    # A run that was interrupted after its last checkpoint, before that was called so.
    last = part / "lerobot" / "checkpoints" / "last"
    last.unlink()
    start(RECIPE, f"resume={part}")
    assert last.resolve().name == "000002"


def test_a_checkpoint_leaves_out_what_is_frozen(tiny: Path) -> None:
    held = {}
    for trained in ("lora", "expert", "full"):
        recipe, config = configured(tiny, trained=trained)
        _, policy, _ = recipe.load(config)
        state = made(recipe, config, policy).state()
        named = policy.named_parameters()
        resting = {name for name, weights in named if not weights.requires_grad}
        assert not resting & state["policy"].keys()
        held[trained] = state, sum(part.numel() for part in state["policy"].values())
    sizes = {trained: size for trained, (_, size) in held.items()}
    assert sizes["lora"] < sizes["expert"] < sizes["full"]
    recipe, config = configured(tiny, trained="full")
    _, policy, _ = recipe.load(config)
    learner = made(recipe, config, policy)
    with pytest.raises(CheckpointError, match="same trained="):
        learner.load(held["expert"][0])


# -- The options -------------------------------------------------------------------


def test_options_reach_the_policy(tiny: Path) -> None:
    recipe, config = configured(
        tiny,
        executed=2,
        method="flow_sde",
        steps=3,
        noisy_steps="one",
        noise_range=[0.05, 0.1],
        noise_level=0.3,
        denoise_reduction="sum",
        log_prob_level="token",
        padded_mean=True,
        keep_prefix=False,
    )
    checkpoint, policy, _ = recipe.load(config)
    # What is trained to act is what LeRobot's commands will do.
    assert (checkpoint.config.num_steps, checkpoint.config.n_action_steps) == (3, 2)
    td = rollout(policy)
    assert td["action"].shape == (4, 2, 7)
    assert td["vla_action", "sample"].shape == (4, 4, 8, 32)
    # Of the chunk's eight steps only those that are executed count.
    assert td["vla_action", "log_probs"].shape == (4, 2, 7)
    assert set(td["vla_prefix"].keys()) == {"summary"}
    assert td["vla_action", "denoise_step"].shape == (4,)
    assert (policy.chain.noise_level, policy.chain.reduction) == (0.3, "sum")
    assert policy.noise.noise_range == (0.05, 0.1)
    assert policy.padded_mean


def test_groups_statistics_and_fewer_steps_of_a_chunk(
    tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(tiny, bare)
    for file in bare.glob("policy_*normalizer*.safetensors"):
        save_file({}, file)
    data = np.random.default_rng(0).normal(size=(2, 12, 7)).astype(np.float32)
    demos = tmp_path / "demos"
    with DemoWriter(
        demos, fps=20, state_names=STATE_NAMES, action_names=ACTION_NAMES
    ) as writer:
        for state, action in zip(*data, strict=True):
            writer.add_frame(state=state, action=action, task="push")
        writer.save_episode()
    given = ["config=debug", f"policy={bare}", "real_coeff=0", "eval_episodes=0"]
    given += ["horizon=4", "iterations=1", "executed=2", f"out={tmp_path / 'run'}"]
    given += ["advantage=mc", "group_size=2", "lr=1e-3"]
    assert "give stats=" in refused(capsys, RECIPE, *given)
    start(RECIPE, *given, f"stats={demos}")
    saved = tmp_path / "run" / LAST
    assert json.loads((saved / "config.json").read_text())["n_action_steps"] == 2
    assert not (saved.parent / "rlco_state" / "critic.safetensors").exists()
    expected = dataset_stats(state=data[0], action=data[1])["action"]
    (file,) = saved.glob("policy_postprocessor*.safetensors")
    kept = load_file(file)
    torch.testing.assert_close(kept["action.std"], expected["std"])
    torch.testing.assert_close(kept["action.mean"], expected["mean"])
    before, after = (load_file(path / "model.safetensors") for path in (bare, saved))
    assert any(not torch.equal(before[name], after[name]) for name in before)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["policy=nowhere", "real_coeff=0"], "has no config.json"),
        (["policy={tiny}"], "real_coeff=0.2 needs real_demos=FOLDER"),
        (["policy={tiny}", "real_coeff=0", "task=push_cub"], "unknown task"),
        (["policy={tiny}", "real_coeff=0", "executed=9"], "executed=9 must be 1 to 8"),
        (["policy={tiny}", "real_coeff=0", "noise_range=[0.2,0.1]"], "0 < least"),
        (["policy={tiny}", "real_coeff=0", "noise_range=[0.1]"], "two numbers"),
        (["policy={tiny}", "real_coeff=0", "noise_level=0"], "must be positive"),
        (["policy={tiny}", "real_coeff=0", "noisy_steps=two"], "noisy_steps"),
        (["policy={tiny}", "real_coeff=0", "stats=nowhere"], "nowhere"),
        (
            ["policy={tiny}", "real_coeff=0", "advantage=mc", "num_envs=9"],
            "not a multiple of group_size=8",
        ),
        (["policy={tiny}", "real_coeff=0", "camera=observation.images.wrist"], "front"),
        (["policy={tiny}", "real_demos=nowhere"], "nowhere"),
    ],
)
def test_wrong_input_ends_with_one_sentence(
    tiny: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    message: str,
) -> None:
    given = [option.format(tiny=tiny) for option in options]
    out = tmp_path / "out"
    assert message in refused(capsys, RECIPE, *given, f"out={out}")
    assert not out.exists()


def test_a_checkpoint_that_reads_another_robots_state_is_refused(
    tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    shutil.copytree(tiny, other)
    for file in other.glob("policy_preprocessor*normalizer*.safetensors"):
        kept = load_file(file)
        wide = {k: torch.ones(9) for k in kept if k.startswith("observation.state.")}
        assert wide
        save_file(kept | wide, file)
    out = tmp_path / "out"
    told = refused(capsys, RECIPE, f"policy={other}", "real_coeff=0", f"out={out}")
    assert "reads 9 state dimensions, the robot or the task gives 7" in told


def test_code_that_a_checkpoint_names_is_refused_until_an_option_names_it(
    tiny: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "my_module.py").write_text(
        "from lerobot.processor import DeviceProcessorStep\n"
        "from rlco.physics.tasks.push_cube import TASK\n"
        "class MyStep(DeviceProcessorStep):\n"
        "    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    mine = tmp_path / "mine"
    shutil.copytree(tiny, mine)
    file = mine / "policy_preprocessor.json"
    raw = json.loads(file.read_text())
    raw["steps"].append({"class": "my_module.MyStep", "config": {}})
    file.write_text(json.dumps(raw))
    # The task that is trained on is named by an option of its own.
    env = {"type": "rlco", "task": "my_module:TASK"}
    training = {"dataset": {"repo_id": "mine/data"}, "env": env}
    (mine / "train_config.json").write_text(json.dumps(training))
    given = [f"policy={mine}", "real_coeff=0", "task=my_module:TASK"]
    out = tmp_path / "out"
    told = refused(capsys, RECIPE, *given, f"out={out}")
    assert "allow_code=['my_module.MyStep']" in told
    assert not out.exists()
    recipe, config = configured(
        mine, task="my_module:TASK", allow_code=["my_module.MyStep"]
    )
    checkpoint, _, _ = recipe.load(config)
    assert type(checkpoint.preprocessor.steps[-1]).__name__ == "MyStep"


def test_options_are_checked_before_the_weights_are_read(
    tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty"
    shutil.copytree(tiny, empty, ignore=shutil.ignore_patterns("model.safetensors"))
    out = f"out={tmp_path / 'out'}"
    given = [f"policy={empty}", "executed=9", "noise_level=-1"]
    told = refused(capsys, RECIPE, *given, out)
    for part in ("executed=9", "noise_level=-1", "needs real_demos=FOLDER"):
        assert part in told
    for options, message in (
        (["real_demos=nowhere"], "nowhere"),
        (["real_coeff=0", "stats=nowhere"], "nowhere"),
        (["real_coeff=0", "camera=observation.images.wrist"], "its cameras are"),
    ):
        assert message in refused(capsys, RECIPE, f"policy={empty}", out, *options)


def test_a_machine_that_cannot_draw_is_told_before_the_weights_are_read(
    tiny: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    empty = tmp_path / "empty"
    shutil.copytree(tiny, empty, ignore=shutil.ignore_patterns("model.safetensors"))

    def fail() -> None:
        raise RenderingError("egl", "no library")

    monkeypatch.setattr(renderers, "check_rendering", fail)
    given = [f"policy={empty}", "real_coeff=0", "renderer=opengl"]
    given.append(f"out={tmp_path / 'out'}")
    assert "no library" in refused(capsys, RECIPE, *given)


def test_gradient_checkpointing_is_refused_before_a_run_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from rlco.policies.tiny.pi05 import write_tiny_pi05

    folder = write_tiny_pi05(tmp_path / "pi05")
    (folder / "model.safetensors").unlink()  # it is not read so far
    file = folder / "config.json"
    raw = json.loads(file.read_text()) | {"gradient_checkpointing": True}
    file.write_text(json.dumps(raw))
    out = tmp_path / "out"
    told = refused(capsys, RECIPE, f"policy={folder}", "real_coeff=0", f"out={out}")
    assert "gradient_checkpointing=false" in told
    assert not out.exists()
