"""A saved policy acts as before; a damaged or foreign checkpoint is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco.errors import CheckpointError, NonFiniteError, UnknownNameError
from rlco.policies import (
    GaussianPolicy,
    load_policy,
    load_weights,
    make_policy,
    save_policy,
)
from rlco.policies.small import checkpoint

EXTRA = {"task": "push_cube", "instructions": ["push red"], "state_names": ["x", "y"]}


def make(**options: Any) -> GaussianPolicy:
    arguments = {"state_size": 2, "chunk": 3, "hidden": (8,), "std": 0.1, **options}
    policy = make_policy("gaussian", **arguments)
    policy.set_normalization(
        state=([0.0, 1.0], [2.0, 5.0]), action=([-0.5] * 7, [0.25] * 7)
    )
    return policy


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    save_policy(make(learn_std=True), tmp_path / "new" / "policy", extra=EXTRA)
    return tmp_path / "new" / "policy"


def test_a_loaded_policy_acts_alike_and_knows_its_task(tmp_path: Path) -> None:
    policy = make(learn_std=True, layer_norm=True, imitation="nll")
    save_policy(policy, tmp_path, extra=EXTRA)
    loaded, extra = load_policy(tmp_path)
    assert extra == EXTRA
    assert loaded.arguments == policy.arguments
    td = TensorDict({"observation": {"state": torch.randn(4, 2)}}, [4])
    with set_exploration_type(ExplorationType.MODE):
        assert torch.equal(loaded(td.clone())["action"], policy(td.clone())["action"])
    td["vla_action", "chunk"] = torch.rand(4, 3, 7)
    assert torch.equal(loaded.imitation_loss(td), policy.imitation_loss(td))


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("token", {"width": 8, "heads": 2, "bins": 16, "temperature": 1.5}),
        ("flow", {"method": "flow_sde", "steps": 3, "noise_level": 0.7}),
        ("flow", {"noise_range": (0.1, 0.3), "padded_size": 32}),
    ],
)
def test_every_kind_draws_alike_after_loading(
    tmp_path: Path, kind: str, options: dict[str, Any]
) -> None:
    policy = make_policy(kind, state_size=2, chunk=3, hidden=(8,), **options)
    policy.set_normalization(action=([-0.5] * 7, [0.25] * 7))
    save_policy(policy, tmp_path)
    loaded, _ = load_policy(tmp_path)
    assert type(loaded) is type(policy)
    drawn = []
    for one in (policy, loaded):
        torch.manual_seed(1)
        drawn.append(one(TensorDict({"observation": {"state": torch.ones(4, 2)}}, [4])))
    for key in policy.out_keys:
        assert torch.equal(drawn[0][key], drawn[1][key])


def test_saving_again_replaces_and_leaves_no_partial_file(saved: Path) -> None:
    save_policy(make(chunk=5), saved)
    assert load_policy(saved)[0].chunk == 5
    names = sorted(path.name for path in saved.iterdir())
    assert names == ["policy.json", "policy.safetensors"]


@pytest.mark.parametrize("name", ["policy.json", "policy.safetensors"])
def test_a_missing_or_truncated_file_is_named(saved: Path, name: str) -> None:
    content = (saved / name).read_bytes()
    (saved / name).write_bytes(content[: len(content) // 2])
    with pytest.raises(CheckpointError, match=name):
        load_policy(saved)
    (saved / name).unlink()
    with pytest.raises(CheckpointError, match=name):
        load_policy(saved)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "gausian"}, "did you mean 'gaussian'"),
        ({"arguments": {"state_size": 2, "chunk": 3, "size": 1}}, "size"),
        ({"arguments": [2, 3]}, "not names with values"),
        ({"arguments": {"state_size": 2, "chunk": 3, "image": {"a": 1}}}, "'size'"),
        ({"arguments": {"state_size": 2, "chunk": "3"}}, "can build"),
        ({"arguments": {"state_size": 2, "chunk": 10**12}}, "weights for at most"),
        (
            {
                "kind": "token",
                "arguments": {"state_size": 2, "chunk": 3, "layers": 10**6},
            },
            "'layers' of .* weights for at most",
        ),
    ],
)
def test_a_description_that_cannot_be_built_is_refused(
    saved: Path, change: dict[str, Any], message: str
) -> None:
    path = saved / "policy.json"
    content = json.loads(path.read_text()) | change
    del content["checksum"]  # as whoever changes it on purpose is told to
    path.write_text(json.dumps(content))
    with pytest.raises(CheckpointError, match=message):
        load_policy(saved)


def test_what_the_weights_are_not_of_takes_no_memory(
    saved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = []

    def build(kind: str, **arguments: Any) -> Any:
        policy = make_policy(kind, **arguments)
        built.append({parameter.device.type for parameter in policy.parameters()})
        return policy

    monkeypatch.setattr(checkpoint, "make_policy", build)
    state = torch.get_rng_state()
    load_policy(saved)
    drawn = torch.get_rng_state()
    torch.set_rng_state(state)
    make(learn_std=True)
    assert torch.equal(torch.get_rng_state(), drawn)  # as many as one policy draws
    assert built == [{"meta"}, {"cpu"}]
    path = saved / "policy.json"
    content = json.loads(path.read_text())
    del content["checksum"]
    content["arguments"]["hidden"] = [10**6, 10**6]  # 4 TB
    path.write_text(json.dumps(content))
    with pytest.raises(CheckpointError, match="another architecture"):
        load_policy(saved)
    assert built[2:] == [{"meta"}]


def test_a_description_without_its_fields_is_refused(saved: Path) -> None:
    (saved / "policy.json").write_text('{"kind": "gaussian"}')
    with pytest.raises(CheckpointError, match="must hold kind, arguments, rlco, extra"):
        load_policy(saved)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hidden": (16,)}, r"trunk\.0\.weight has shape \(8, 2\), expected \(16, 2\)"),
        ({"hidden": (8, 8)}, r"trunk\.2\.weight is missing"),
        ({"hidden": ()}, r"trunk\.0\.bias is not expected"),
    ],
)
def test_another_architecture_is_refused_and_changes_nothing(
    saved: Path, options: dict[str, Any], message: str
) -> None:
    policy = make(**options)
    before = {name: value.clone() for name, value in policy.state_dict().items()}
    with pytest.raises(CheckpointError, match=f"another architecture: .*{message}"):
        load_weights(policy, saved)
    for name, value in policy.state_dict().items():
        assert torch.equal(value, before[name])


def test_at_most_three_differences_are_listed(saved: Path) -> None:
    with pytest.raises(CheckpointError, match=r"\(and \d+ more\)") as caught:
        load_weights(make(hidden=(8, 8, 8), layer_norm=True), saved)
    assert str(caught.value).count("is missing") == 3


def test_an_unknown_kind_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="unknown policy 'flows'"):
        make_policy("flows")


# -- What is not finite --------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [("network.trunk.0.weight", torch.nan), ("action_normalizer.high", torch.inf)],
)
def test_a_file_with_numbers_that_are_not_finite_is_refused(
    saved: Path, name: str, value: float
) -> None:
    path = saved / "policy.safetensors"
    weights = load_file(path)
    assert name in weights
    weights[name].view(-1)[1] = value
    save_file(weights, path)
    policy = make(learn_std=True)
    before = {name: value.clone() for name, value in policy.state_dict().items()}
    for load in (lambda: load_policy(saved), lambda: load_weights(policy, saved)):
        with pytest.raises(CheckpointError) as caught:
            load()
        assert str(path) in str(caught.value)
        assert f"{name} is " in str(caught.value)
        assert "(1 of " in str(caught.value)
    for name, value in policy.state_dict().items():
        assert torch.equal(value, before[name])


def test_a_policy_that_is_not_finite_replaces_none(saved: Path, tmp_path: Path) -> None:
    before = (saved / "policy.safetensors").read_bytes()
    policy = make(learn_std=True)
    policy.network.head.bias.data[2] = torch.nan
    for folder in (saved, tmp_path / "other"):
        with pytest.raises(NonFiniteError, match=r"is not written, as network\.head"):
            save_policy(policy, folder)
    assert (saved / "policy.safetensors").read_bytes() == before
    assert not (tmp_path / "other").exists()
