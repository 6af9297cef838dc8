"""LeRobot's folders: loaded whole, refused otherwise, and written for LeRobot."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.common.train_utils import load_training_state
from lerobot.configs import PreTrainedConfig
from lerobot.configs.default import DatasetConfig, WandBConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.optim import AdamWConfig, DiffuserSchedulerConfig, SGDConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.utils.sample_weighting import SampleWeightingConfig
from safetensors.torch import load_file, save_file
from transformers import AutoConfig, SmolVLMForConditionalGeneration
from vla_cases import KINDS, actor, folder, rows

from rlco.errors import CheckpointError, NonFiniteError
from rlco.policies.vla.lerobot import export as lerobot_export
from rlco.policies.vla.lerobot.checkpoint import load_lerobot
from rlco.policies.vla.lerobot.export import load_beside, save_lerobot
from rlco.policies.vla.lerobot.inputs import dataset_stats
from rlco.policies.vla.lerobot.policy import LeRobotPolicy
from rlco.policies.vla.lerobot.trained_weights import add_expert_lora
from rlco.runs.state_files import save_state
from rlco.training import MasterWeightAdamW

pytestmark = pytest.mark.slow

both = pytest.mark.parametrize("kind", KINDS)
Weights = dict[str, torch.Tensor]


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    path = tmp_path / "pretrained_model"
    shutil.copytree(folder("smolvla"), path)
    return path


def rewrite(path: Path, change: Callable[[Weights], object]) -> None:
    weights = load_file(path / "model.safetensors")
    change(weights)
    save_file(weights, path / "model.safetensors")


def configure(path: Path, **values: Any) -> None:
    file = path / "config.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | values))


@both
def test_every_weight_comes_from_the_file(kind: str) -> None:
    loaded = load_lerobot(folder(kind)).model.policy.state_dict()
    saved = load_file(folder(kind) / "model.safetensors")
    assert saved
    for name, value in saved.items():
        assert torch.equal(loaded[name], value), name


def test_smolvlms_own_weights_are_not_asked_for(
    copied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As LeRobot builds it where SmolVLM's weights lie beside its configuration.
    whole = copied.parent / "vlm"
    shutil.copytree(copied / "vlm", whole)
    source = SmolVLMForConditionalGeneration(AutoConfig.from_pretrained(whole))
    source.save_pretrained(whole)
    configure(copied, load_vlm_weights=True, vlm_model_name=str(whole))
    config = PreTrainedConfig.from_pretrained(copied)
    theirs = dict(get_policy_class("smolvla")(config).named_parameters())
    # Without them, and without a network.
    shutil.rmtree(whole)
    shutil.copytree(copied / "vlm", whole)
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    checkpoint = load_lerobot(copied)
    ours = dict(checkpoint.model.policy.named_parameters())
    assert {k: v.dtype for k, v in ours.items()} == {
        k: v.dtype for k, v in theirs.items()
    }
    assert {v.dtype for v in ours.values()} == {torch.bfloat16, torch.float32}
    saved = load_file(copied / "model.safetensors")
    for name, value in ours.items():
        assert torch.equal(value, saved[name].to(value.dtype)), name
    policy = LeRobotPolicy(checkpoint, instructions=("push", "pull"))
    assert torch.isfinite(policy.imitation_loss(rows(2))).all()
    # What is written back is what was read.
    again = save_lerobot(checkpoint, tmp_path / "out", step=1)
    assert json.loads((again / "config.json").read_text())["load_vlm_weights"] is True


def test_names_without_lerobots_prefix_are_those_of_openpi(tmp_path: Path) -> None:
    path = tmp_path / "pi05"
    shutil.copytree(folder("pi05"), path)
    weights = load_file(path / "model.safetensors")
    renamed = {name.removeprefix("model."): value for name, value in weights.items()}
    save_file(renamed, path / "model.safetensors")
    loaded = load_lerobot(path).model.policy.state_dict()
    assert all(torch.equal(loaded[name], value) for name, value in weights.items())


EXPERT = "model.vlm_with_expert.lm_expert.layers.0.mlp.up_proj.weight"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda w: w.pop(EXPERT), f"{EXPERT} is missing"),
        (
            lambda w: w.update({"value_head.weight": torch.zeros(1)}),
            "value_head.weight is not expected",
        ),
        (
            lambda w: w.update({EXPERT: w[EXPERT][:-1].clone()}),
            r"shape \(255, 36\), expected \(256, 36\)",
        ),
    ],
)
def test_a_load_that_leaves_a_weight_unset_fails(
    copied: Path, change: Callable[[Weights], object], message: str
) -> None:
    rewrite(copied, change)
    with pytest.raises(CheckpointError, match=message):
        load_lerobot(copied)


@both
def test_a_weight_that_is_not_finite_is_refused(kind: str, tmp_path: Path) -> None:
    shutil.copytree(folder(kind), tmp_path / "copy")
    name = sorted(load_file(tmp_path / "copy" / "model.safetensors"))[-1]

    def spoil(weights: Weights) -> None:
        weights[name].view(-1)[0] = torch.nan

    rewrite(tmp_path / "copy", spoil)
    with pytest.raises(CheckpointError, match=rf"{name} is nan \(1 of "):
        load_lerobot(tmp_path / "copy")


def test_a_missing_weight_file_is_no_random_model(copied: Path) -> None:
    (copied / "model.safetensors").unlink()
    with pytest.raises(CheckpointError, match=r"file of weights .* is (missing|dam)"):
        load_lerobot(copied)


def test_a_pipe_in_the_folder_is_not_waited_for(copied: Path) -> None:
    for name in ("policy_preprocessor.json", "model.safetensors"):
        (copied / name).unlink()
        os.mkfifo(copied / name)
        with pytest.raises(CheckpointError, match=rf"{name}' (is no file|holds no)"):
            load_lerobot(copied)
        (copied / name).unlink()
        shutil.copy(folder("smolvla") / name, copied / name)


def test_a_truncated_processor_state_is_told(copied: Path) -> None:
    file = next(copied.glob("policy_preprocessor_step_*_normalizer*.safetensors"))
    file.write_bytes(file.read_bytes()[:20])
    with pytest.raises(CheckpointError, match="a processor of the checkpoint"):
        load_lerobot(copied)


def test_a_checkpoint_of_another_action_size_is_refused() -> None:
    with pytest.raises(CheckpointError, match=r"7 action dimensions.*the task 6"):
        load_lerobot(folder("smolvla"), action_size=6)


def test_a_checkpoint_of_another_state_size_is_refused(copied: Path) -> None:
    with pytest.raises(CheckpointError, match=r"reads 7 state dimensions.*gives 9"):
        load_lerobot(copied, state_size=9)
    # Fine-tuned from a base of another robot: config.json keeps what the base had.
    file = copied / "config.json"
    raw = json.loads(file.read_text())
    raw["input_features"]["observation.state"]["shape"] = [6]
    file.write_text(json.dumps(raw))
    checkpoint = load_lerobot(copied, state_size=7)
    policy = LeRobotPolicy(checkpoint, instructions=("push", "pull"))
    assert policy.inputs.state_size == 7
    assert torch.isfinite(policy.imitation_loss(rows(2))).all()


def test_missing_statistics_are_refused_and_can_be_given(copied: Path) -> None:
    file = next(copied.glob("policy_preprocessor_step_*_normalizer*.safetensors"))
    kept = load_file(file)
    save_file({k: v for k, v in kept.items() if k != "action.std"}, file)
    with pytest.raises(CheckpointError, match=r"'action' by MEAN_STD.*no std"):
        load_lerobot(copied)
    data = np.random.default_rng(0).normal(size=(100, 7))
    stats = dataset_stats(state=data, action=2 * data + 1)
    checkpoint = load_lerobot(copied, stats=stats)
    raw = checkpoint.postprocessor(torch.ones(1, 7))
    expected = 2 * data.std(0) + (2 * data + 1).mean(0)
    np.testing.assert_allclose(raw[0], expected, rtol=1e-5)


def test_statistics_are_those_of_all_frames() -> None:
    data = np.concatenate([np.zeros((90, 1)), np.full((10, 1), 10.0)])
    found = dataset_stats(action=data)["action"]
    assert float(found["mean"]) == pytest.approx(1.0)
    assert float(found["std"]) == pytest.approx(3.0)
    assert float(found["q99"]) == 10.0
    assert float(found["q90"]) == pytest.approx(1.0)  # between frames 89 and 90


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"type": "act"}, "of the type 'act', whose actions have no log-probability"),
        ({"type": "unheard_of"}, "install the plugin"),
        ({"adapt_to_pi_aloha": True}, "adapt_to_pi_aloha=true"),
        ({"use_cache": False}, "use_cache=false"),
        ({"output_features": {}}, "no action feature"),
        ({"option_of_another_lerobot": 1}, "not a configuration that LeRobot can read"),
        ({"num_steps": "four"}, "not a configuration that LeRobot can read"),
        ({"vlm_model_name": "nowhere/vlm"}, "'nowhere/vlm'.*tokenizer=FOLDER"),
    ],
)
def test_other_checkpoints_are_refused(
    copied: Path, values: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without a network, a name on the hub is asked for again and again for 20 s.
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    if values.get("type") == "act":
        raw = {"type": "act", "device": "cpu"}
        (copied / "config.json").write_text(json.dumps(raw))
    else:
        configure(copied, **values)
    with pytest.raises(CheckpointError, match=message):
        load_lerobot(copied)


def test_a_training_of_another_lerobot_is_refused_before_it_is_trained(
    copied: Path,
) -> None:
    (copied / "model.safetensors").unlink()  # it is not read so far
    broken = ('{"option_of_another_lerobot": 1}', '{"env": {"type": "gone"}}')
    for text, advice in (
        *((one, "take the file away") for one in broken),
        ("null", "holds None, not names with values; copy the folder again"),
        ("{", "is truncated or damaged.*copy the folder again"),
    ):
        (copied / "train_config.json").write_text(text)
        with pytest.raises(CheckpointError, match=advice):
            load_lerobot(copied)


def test_checkpoints_from_before_processors_are_refused(copied: Path) -> None:
    file = copied / "policy_preprocessor.json"
    whole = json.loads(file.read_text())
    steps = [s for s in whole["steps"] if s["registry_name"] != "device_processor"]
    file.write_text(json.dumps(whole | {"steps": steps}))
    with pytest.raises(CheckpointError, match=r"lacks a processor.*device_processor"):
        load_lerobot(copied)
    for kind in ("pre", "post"):
        (copied / f"policy_{kind}processor.json").unlink()
    with pytest.raises(CheckpointError, match=r"lacks a processor.*LeRobot 0\.6"):
        load_lerobot(copied)


def test_relative_actions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "pi05"
    shutil.copytree(folder("pi05"), path)
    configure(path, use_relative_actions=True)
    with pytest.raises(CheckpointError, match="use_relative_actions=true"):
        load_lerobot(path)


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"no config\.json"):
        load_lerobot(tmp_path)


def test_a_missing_tokenizer_names_the_option(copied: Path, tmp_path: Path) -> None:
    shutil.move(copied / "vlm", tmp_path / "moved")
    file = copied / "policy_preprocessor.json"
    gone = str(tmp_path / "gone")
    file.write_text(file.read_text().replace(str(folder("smolvla") / "vlm"), gone))
    configure(copied, vlm_model_name=gone)
    with pytest.raises(CheckpointError, match="tokenizer=FOLDER"):
        load_lerobot(copied)
    checkpoint = load_lerobot(copied, tokenizer=tmp_path / "moved")
    assert checkpoint.config.vlm_model_name == str(tmp_path / "moved")


# -- Written for LeRobot ------------------------------------------------------------


@both
def test_what_is_saved_lerobot_loads_and_acts_as_trained(
    kind: str, tmp_path: Path
) -> None:
    policy = actor(kind)
    optimizer = torch.optim.AdamW(policy.policy.parameters(), lr=1e-2)
    policy.imitation_loss(rows(4)).mean().backward()
    optimizer.step()
    checkpoint = load_lerobot(folder(kind))
    checkpoint.model.policy.load_state_dict(policy.policy.state_dict())
    saved = save_lerobot(
        checkpoint,
        tmp_path,
        step=7,
        optimizer=optimizer,
        beside={"noise": dict(policy.noise.state_dict())},
    )
    assert saved == tmp_path / "checkpoints" / "000007" / "pretrained_model"
    assert (tmp_path / "checkpoints" / "last").resolve() == saved.parent
    before = load_file(folder(kind) / "model.safetensors")
    after = load_file(saved / "model.safetensors")
    assert before.keys() == after.keys()
    changed = {name for name in before if not torch.equal(before[name], after[name])}
    trained = {
        name
        for name, p in policy.policy.named_parameters()
        if p.requires_grad and p.grad is not None
    }
    assert changed
    assert changed <= trained
    # Stock LeRobot, from the folder alone.
    config = PreTrainedConfig.from_pretrained(saved)
    assert config.type == load_lerobot(folder(kind)).config.type
    theirs = get_policy_class(config.type).from_pretrained(saved, config=config)
    pre, post = make_pre_post_processors(config, pretrained_path=str(saved))
    batch = pre(
        {
            "observation.state": torch.zeros(2, 7),
            "observation.images.front": torch.full((2, 3, 64, 64), 0.5),
            "task": ["push the blue cube onto its mark"] * 2,
        }
    )
    torch.manual_seed(0)
    actions = post(theirs.predict_action_chunk(batch))
    policy.policy.eval()
    torch.manual_seed(0)
    # Un-normalising by quantiles -1 and 1 rounds.
    expected = policy.policy.predict_action_chunk(batch)
    torch.testing.assert_close(actions, expected, atol=1e-6, rtol=1e-6)
    noise = load_beside(saved, "noise")
    assert all(torch.equal(noise[k], v) for k, v in policy.noise.state_dict().items())
    assert load_beside(saved, "critic") is None
    # Stock LeRobot reads on what rlco does not: a bit in the middle of a weight.
    weights = bytearray((saved / "model.safetensors").read_bytes())
    weights[len(weights) // 2] ^= 1
    (saved / "model.safetensors").write_bytes(weights)
    with pytest.raises(CheckpointError, match=r"model.safetensors' is damaged: its"):
        load_lerobot(saved)


def test_a_checkpoint_is_not_overwritten(tmp_path: Path) -> None:
    checkpoint = load_lerobot(folder("smolvla"))
    save_lerobot(checkpoint, tmp_path, step=1)
    with pytest.raises(CheckpointError, match="is not overwritten"):
        save_lerobot(checkpoint, tmp_path, step=1)


def spoil_weight(policy: LeRobotPolicy, optimizer: Any, beside: Weights) -> None:
    del optimizer, beside
    policy.policy.model.action_out_proj.bias.data[0] = torch.nan


def spoil_moment(policy: LeRobotPolicy, optimizer: Any, beside: Weights) -> None:
    del beside
    bias = policy.policy.model.action_out_proj.bias
    optimizer.state[bias]["exp_avg_sq"][0] = torch.inf


def spoil_beside(policy: LeRobotPolicy, optimizer: Any, beside: Weights) -> None:
    del policy, optimizer
    beside["weight"][0] = torch.nan


@pytest.mark.parametrize(
    ("spoil", "name"),
    [
        (spoil_weight, "policy.model.action_out_proj.bias is nan"),
        (spoil_moment, "exp_avg_sq is infinite"),
        (spoil_beside, "critic.weight is nan"),
    ],
)
def test_what_is_not_finite_is_not_saved(
    tmp_path: Path, spoil: Callable[..., None], name: str
) -> None:
    policy = actor("smolvla")
    checkpoint = load_lerobot(folder("smolvla"))
    checkpoint.model.policy = policy.policy
    optimizer = torch.optim.AdamW(policy.policy.parameters(), lr=1e-4)
    policy.imitation_loss(rows(2)).mean().backward()
    optimizer.step()
    beside = {"weight": torch.ones(2)}
    first = save_lerobot(checkpoint, tmp_path, step=1, beside={"critic": beside})
    spoil(policy, optimizer, beside)
    with pytest.raises(NonFiniteError, match=name):
        save_lerobot(
            checkpoint,
            tmp_path,
            step=2,
            optimizer=optimizer,
            beside={"critic": beside},
        )
    left = {file.name for file in (tmp_path / "checkpoints").iterdir()}
    assert left == {"000001", "last"}
    assert (tmp_path / "checkpoints" / "last").resolve() == first.parent


def test_a_critic_that_is_not_finite_is_not_read_back(tmp_path: Path) -> None:
    checkpoint = load_lerobot(folder("smolvla"))
    saved = save_lerobot(checkpoint, tmp_path, step=1, beside={"critic": {}})
    file = saved.parent / lerobot_export.BESIDE / "critic.safetensors"
    save_state(file, {"weight": torch.tensor([1.0, torch.nan])})
    with pytest.raises(CheckpointError, match="weight is nan"):
        load_beside(saved, "critic")


def test_an_interrupted_save_leaves_nothing_that_looks_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = load_lerobot(folder("smolvla"))
    first = save_lerobot(checkpoint, tmp_path, step=1)

    def full(*_: Any) -> None:
        raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(lerobot_export, "save_state", full)
        with pytest.raises(OSError, match="no space left"):
            save_lerobot(checkpoint, tmp_path, step=2, beside={"critic": {}})
    assert (tmp_path / "checkpoints" / "000002.partial").exists()
    assert not (tmp_path / "checkpoints" / "000002").exists()
    assert (tmp_path / "checkpoints" / "last").resolve() == first.parent
    again = save_lerobot(checkpoint, tmp_path, step=3, beside={"critic": {}})
    assert (tmp_path / "checkpoints" / "last").resolve() == again.parent
    assert load_beside(again, "critic") == {}
    left = {file.name for file in (tmp_path / "checkpoints").iterdir()}
    assert left == {"000001", "000003", "last"}


@both
def test_lerobots_commands_denoise_and_execute_as_trained(
    kind: str, tmp_path: Path
) -> None:
    checkpoint = load_lerobot(folder(kind))
    policy = LeRobotPolicy(checkpoint, instructions=("a",), steps=3, executed=2)
    saved = save_lerobot(checkpoint, tmp_path, step=1)
    held = json.loads((saved / "config.json").read_text())
    name = {"pi05": "num_inference_steps", "smolvla": "num_steps"}[kind]
    assert (held[name], held["n_action_steps"]) == (3, 2)
    config = PreTrainedConfig.from_pretrained(saved)
    theirs = get_policy_class(config.type).from_pretrained(saved, config=config)
    calls = []
    part = theirs.model.action_out_proj
    part.register_forward_hook(lambda *_: calls.append(1))
    batch = policy.inputs.observe(rows(1).exclude("vla_action"))
    theirs.predict_action_chunk(batch)
    assert len(calls) == 3


def test_a_resumed_training_reads_the_anchor_and_none_of_what_was_before(
    copied: Path, tmp_path: Path
) -> None:
    before = TrainPipelineConfig(
        dataset=DatasetConfig(repo_id="theirs/other", eval_split=0.1),
        policy=PreTrainedConfig.from_pretrained(copied),
        rename_map={"observation.images.top": "observation.images.front"},
        eval_steps=50,
        sample_weighting=SampleWeightingConfig(type="uniform"),
        use_policy_training_preset=False,
        optimizer=SGDConfig(lr=0.3, grad_clip_norm=3.0),
        scheduler=DiffuserSchedulerConfig(num_warmup_steps=1),
        wandb=WandBConfig(enable=True, run_id="theirs"),
        save_checkpoint_to_hub=True,
        steps=3,
        batch_size=5,
    )
    before.save_pretrained(copied)
    checkpoint = load_lerobot(copied)
    seen = "observation.images.front"
    optimizer = MasterWeightAdamW(checkpoint.model.policy.parameters(), lr=3e-4)
    options: dict[str, Any] = {
        "data": tmp_path / "real",
        "rename": {"observation.images.cam": seen},
        "optimizer": optimizer,
    }
    anchored = save_lerobot(checkpoint, tmp_path / "a", step=7, **options)
    held = TrainPipelineConfig.from_pretrained(anchored)
    assert held.dataset.root == str(tmp_path / "real")
    assert held.rename_map == options["rename"]
    assert (held.eval_steps, held.sample_weighting) == (0, None)
    assert (held.steps, held.batch_size) == (7, 5)
    # Else LeRobot refuses it, as it has an optimiser and no schedule.
    assert held.use_policy_training_preset
    # Nor does it go on in their log and repository.
    assert not held.wandb.enable
    assert held.wandb.run_id is None
    assert not held.save_checkpoint_to_hub
    assert held.policy.push_to_hub is False
    # The optimiser is the one whose state is beside it.
    assert isinstance(held.optimizer, AdamWConfig)
    assert (held.optimizer.lr, held.optimizer.grad_clip_norm) == (3e-4, 3.0)
    resumed = held.optimizer.build(checkpoint.model.policy.parameters())
    load_training_state(anchored.parent, resumed, None)
    # Without an anchor the data stays what it was.
    bare = TrainPipelineConfig.from_pretrained(
        save_lerobot(checkpoint, tmp_path / "b", step=7)
    )
    assert bare.dataset.repo_id == "theirs/other"
    assert bare.rename_map == before.rename_map
    assert bare.eval_steps == 50


@both
def test_lerobot_resumes_what_had_adapters(kind: str, tmp_path: Path) -> None:
    checkpoint = load_lerobot(folder(kind))
    policy = LeRobotPolicy(checkpoint, instructions=("push", "pull"))
    add_expert_lora(policy.model, rank=2)
    saved = save_lerobot(checkpoint, tmp_path, step=4)
    config = TrainPipelineConfig.from_pretrained(saved)
    held = PreTrainedConfig.from_pretrained(saved)
    theirs = get_policy_class(held.type).from_pretrained(saved, config=held)
    optimizer = config.optimizer.build(theirs.get_optim_params())
    step, _, _ = load_training_state(saved.parent, optimizer, None)
    assert step == 4
    theirs.eval()
    assert len(optimizer.param_groups[0]["params"]) == len(list(theirs.parameters()))


@both
def test_adapters_are_merged_into_what_is_saved(kind: str, tmp_path: Path) -> None:
    checkpoint = load_lerobot(folder(kind))
    policy = LeRobotPolicy(checkpoint, instructions=("push", "pull"))
    td = rows(3)
    torch.manual_seed(0)
    before = policy.imitation_loss(td)
    add_expert_lora(policy.model, rank=2)
    torch.manual_seed(0)
    assert torch.equal(policy.imitation_loss(td), before)  # they start at 0
    trained = [n for n, p in policy.policy.named_parameters() if p.requires_grad]
    assert trained
    assert all(".lora_" in name for name in trained)
    with torch.no_grad():
        for name, parameter in policy.policy.named_parameters():
            if ".lora_" in name:
                parameter.add_(0.1)
    torch.manual_seed(0)
    expected = policy.imitation_loss(td)
    assert not torch.allclose(expected, before)
    saved = save_lerobot(checkpoint, tmp_path, step=1)
    assert load_file(saved / "model.safetensors").keys() == (
        load_file(folder(kind) / "model.safetensors").keys()
    )
    merged = LeRobotPolicy(load_lerobot(saved), instructions=("push", "pull"))
    torch.manual_seed(0)
    torch.testing.assert_close(merged.imitation_loss(td), expected)
