"""No file of somebody else's folder chooses code that runs."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.policies.factory import make_pre_post_processors
from lerobot.policies.pi05.configuration_pi05 import PI05Config
from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
from lerobot.processor import (
    ComplementaryDataProcessorStep,
    ProcessorStepRegistry,
    tokenizer_processor,
)
from transformers import dynamic_module_utils
from transformers.integrations import hub_kernels
from vla_cases import INSTRUCTIONS, KINDS, folder

from rlco.errors import CheckpointError
from rlco.policies.tiny.tokenizer import make_tokenizer
from rlco.policies.vla.lerobot.checkpoint import load_lerobot
from rlco.policies.vla.lerobot.steps import STEPS
from rlco.policies.vla.openvla.inputs import prompt_tokens
from rlco.policies.vla.openvla.load import load_openvla

both = pytest.mark.parametrize("kind", KINDS)
each_file = pytest.mark.parametrize(
    "file", ["policy_preprocessor.json", "policy_postprocessor.json"]
)


@pytest.fixture
def marker(tmp_path: Path) -> Path:
    """Return a file that is there once a folder's code has run."""
    return tmp_path / "it_ran"


@pytest.fixture(autouse=True)
def their_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep what transformers copies of a folder's code out of the user's cache."""
    cache = str(tmp_path / "modules")
    monkeypatch.setattr(dynamic_module_utils, "HF_MODULES_CACHE", cache)
    monkeypatch.setattr(sys, "path", [*sys.path, cache])


@pytest.fixture
def says_yes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Answer yes to every question at the terminal; return the questions."""
    asked: list[str] = []

    def answer(question: str = "") -> str:
        asked.append(question)
        return "y"

    monkeypatch.setattr("builtins.input", answer)
    return asked


def copied(kind: str, path: Path) -> Path:
    shutil.copytree(folder(kind), path)
    return path


def edit(file: Path, change: Callable[[Any], object]) -> None:
    raw = json.loads(file.read_text()) if file.exists() else {}
    change(raw)
    file.write_text(json.dumps(raw))


def with_step(folder: Path, file: str, step: dict[str, Any]) -> Path:
    edit(folder / file, lambda raw: raw["steps"].append(step))
    return folder


def with_code(folder: Path, marker: Path, auto: str, file: str) -> None:
    """Put a class beside a tokenizer that only its own Python can build."""
    folder.mkdir(exist_ok=True)
    (folder / "theirs.py").write_text(
        f"open({str(marker)!r}, 'w').close()\n"
        "class Theirs:\n"
        "    @classmethod\n"
        "    def from_pretrained(cls, *_, **__):\n"
        "        return cls()\n"
    )
    name = ["theirs.Theirs", None] if auto == "AutoTokenizer" else "theirs.Theirs"
    edit(folder / file, lambda raw: raw.update(auto_map={auto: name}))


# -- Steps of the processors ---------------------------------------------------------


@both
@each_file
def test_a_step_that_is_any_function_does_not_run(
    kind: str, file: str, tmp_path: Path, marker: Path
) -> None:
    call = {"class": "subprocess.getoutput", "config": {"cmd": f"touch {marker}"}}
    path = with_step(copied(kind, tmp_path / "theirs"), file, call)
    with pytest.raises(CheckpointError, match=r"subprocess\.getoutput") as caught:
        load_lerobot(path)
    assert not marker.exists()
    for part in (file, "normalizer_processor", "allow_code=['subprocess.getoutput']"):
        assert part in str(caught.value)


@pytest.mark.parametrize("config", [{"trust_remote_code": True}, {}])
def test_python_beside_a_tokenizer_does_not_run(
    config: dict[str, Any], tmp_path: Path, marker: Path
) -> None:
    tokenizer = tmp_path / "tokenizer"
    with_code(tokenizer, marker, "AutoProcessor", "processor_config.json")
    names = {"action_tokenizer_name": str(tokenizer)}
    # By default LeRobot trusts this one's tokenizer.
    step = {"registry_name": "action_tokenizer_processor", "config": names | config}
    path = copied("smolvla", tmp_path / "theirs")
    with_step(path, "policy_preprocessor.json", step)
    for allowed in ([], ["action_tokenizer_processor"]):
        with pytest.raises(CheckpointError, match="trust_remote_code"):
            load_lerobot(path, allow_code=allowed)
    assert not marker.exists()


def nest(value: Any) -> Callable[[Any], object]:
    """Return a change that hides an option in a processor's fourth step."""
    return lambda raw: raw["steps"][3]["config"].update(
        tokenizer_kwargs=[{"trust_remote_code": value}]
    )


@pytest.mark.parametrize(
    ("file", "change", "place"),
    [
        (
            "policy_preprocessor.json",
            nest(True),
            "steps.3.config.tokenizer_kwargs.0.trust_remote_code",
        ),
        ("policy_preprocessor.json", nest("yes"), "steps.3"),
        (
            "config.json",
            lambda raw: raw.update(trust_remote_code=True),
            "trust_remote_code",
        ),
        (
            "train_config.json",
            lambda raw: raw.update(env={"type": "pusht", "trust_remote_code": 1}),
            "env.trust_remote_code",
        ),
    ],
)
def test_trust_in_remote_code_is_refused_wherever_it_is_asked_for(
    file: str, change: Callable[[Any], object], place: str, tmp_path: Path
) -> None:
    path = copied("smolvla", tmp_path / "theirs")
    edit(path / file, change)
    with pytest.raises(CheckpointError, match="set it to false") as caught:
        load_lerobot(path)
    assert file in str(caught.value)
    assert place in str(caught.value)


@pytest.mark.parametrize(
    "step",
    [
        {"registry_name": "image_crop_resize_processor"},
        {"registry_name": "device_processor", "class": "subprocess.getoutput"},
        {"class": "lerobot.processor.DeviceProcessorStep"},
    ],
)
def test_other_steps_are_refused(step: dict[str, str], tmp_path: Path) -> None:
    path = with_step(copied("pi05", tmp_path / "a"), "policy_preprocessor.json", step)
    with pytest.raises(CheckpointError, match="allowed are"):
        load_lerobot(path)


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "\xff",
        '{"steps": {"class": "a.B"}}',
        '{"steps": ["tokenizer_processor"]}',
        '{"steps": [{"config": {}}]}',
        '{"steps": [{"registry_name": ["tokenizer_processor"]}]}',
    ],
)
def test_processors_without_a_list_of_steps_are_refused(
    text: str, tmp_path: Path
) -> None:
    path = copied("smolvla", tmp_path / "theirs")
    (path / "policy_postprocessor.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(CheckpointError, match="no list of steps"):
        load_lerobot(path)


def test_the_steps_of_lerobots_own_checkpoints_are_allowed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Local:
        @staticmethod
        def from_pretrained(*_: Any, **__: Any) -> Any:
            return make_tokenizer()

    # The published models' tokenizers are on the Hub.
    monkeypatch.setattr(tokenizer_processor, "AutoTokenizer", Local)
    written = {
        step["registry_name"]
        for config in (PI05Config(device="cpu"), SmolVLAConfig(device="cpu"))
        for processor in make_pre_post_processors(config)
        for step in processor.get_config()["steps"]
    }
    assert written == STEPS


class Shout(ComplementaryDataProcessorStep):
    """A user's own step, that LeRobot finds by its name in Python."""

    def complementary_data(self, complementary_data: Any) -> Any:
        task = [text.upper() for text in complementary_data["task"]]
        return complementary_data | {"task": task}

    def transform_features(self, features: Any) -> Any:
        return features


@ProcessorStepRegistry.register("test_foreign_code_shout")
class RegisteredShout(Shout):
    """The same, registered by a plugin."""


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("class", f"{__name__}.Shout"),
        ("registry_name", "test_foreign_code_shout"),
    ],
)
def test_a_users_own_step_is_allowed_by_its_name(
    key: str, name: str, tmp_path: Path
) -> None:
    path = copied("smolvla", tmp_path / "mine")
    edit(path / "policy_preprocessor.json", lambda r: r["steps"].insert(2, {key: name}))
    with pytest.raises(CheckpointError, match=r"allow_code=\['"):
        load_lerobot(path, allow_code=["my_module.Another"])
    with pytest.raises(CheckpointError, match=r"allow_code=\['"):
        load_lerobot(path, allow_code=f"{name}.Another")
    checkpoint = load_lerobot(path, allow_code=name)
    assert isinstance(checkpoint.preprocessor.steps[2], Shout)


# -- Tokenizers and models -----------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "file"),
    [
        ("pi05", "tokenizer_config.json"),
        ("smolvla", "tokenizer_config.json"),
        ("smolvla", "config.json"),
    ],
)
def test_code_of_a_tokenizers_folder_is_not_asked_about(
    kind: str, file: str, tmp_path: Path, marker: Path, says_yes: list[str]
) -> None:
    path = copied(kind, tmp_path / "theirs")
    tokenizer = path / {"smolvla": "vlm", "pi05": "tokenizer"}[kind]
    auto = {"config.json": "AutoConfig", "tokenizer_config.json": "AutoTokenizer"}[file]
    if file == "tokenizer_config.json":  # a class that transformers does not have
        edit(tokenizer / file, lambda raw: raw.update(tokenizer_class="Theirs"))
    else:
        edit(tokenizer / file, lambda raw: raw.update(model_type="theirs"))
    with_code(tokenizer, marker, auto, file)
    with pytest.raises(CheckpointError, match=r"tokenizer=FOLDER"):
        load_lerobot(path, tokenizer=tokenizer)
    assert not marker.exists()
    assert not says_yes


@pytest.mark.parametrize("kind", ["smolvla", "openvla"])
def test_kernels_that_a_configuration_names_are_not_fetched(
    kind: str, tmp_path: Path, marker: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fetch(*_: Any, **__: Any) -> None:
        marker.touch()
        raise ImportError("fetched")

    # As if the package kernels were installed, which runs what it fetches.
    monkeypatch.setattr(hub_kernels, "_kernels_available", True)
    monkeypatch.setattr(hub_kernels, "get_kernel", fetch)
    # A revision, as a pull request has one too; transformers tries each name once.
    kernel = {"attn_implementation": f"kernels-community/flash-attn2@0123{kind}"}
    path = copied(kind, tmp_path / "theirs")
    load: Callable[[], Any]
    if kind == "smolvla":
        edit(path / "vlm" / "config.json", lambda raw: raw.update(kernel))
        load = partial(load_lerobot, path, tokenizer=path / "vlm")
    else:
        edit(path / "config.json", lambda raw: raw["text_config"].update(kernel))
        load = partial(load_openvla, path)
    with pytest.raises(CheckpointError, match="flash-attn2"):
        load()
    assert not marker.exists()


def test_openvlas_own_python_does_not_run(
    tmp_path: Path, marker: Path, says_yes: list[str]
) -> None:
    path = copied("openvla", tmp_path / "theirs")
    # The published folder has both: its configuration and its model are Python.
    with_code(path, marker, "AutoConfig", "config.json")
    with_code(path, marker, "AutoTokenizer", "tokenizer_config.json")
    model = load_openvla(path, dtype=torch.float32)
    tokens, _ = prompt_tokens(model.config, INSTRUCTIONS, path)
    assert len(tokens) == len(INSTRUCTIONS)
    assert not marker.exists()
    assert not says_yes


# -- The configuration of the training -----------------------------------------------


def test_a_task_in_python_is_not_imported_unless_it_is_named(
    tmp_path: Path, marker: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = copied("smolvla", tmp_path / "theirs")
    source = (
        f"import pathlib; pathlib.Path({str(marker)!r}).touch()\n"
        "from rlco.physics.tasks.push_cube import TASK\n"
    )
    (tmp_path / "task_of_theirs.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    config = TrainPipelineConfig(dataset=DatasetConfig(repo_id="theirs/data"))
    config.save_pretrained(path)
    env = {"type": "rlco", "task": "task_of_theirs:TASK"}
    edit(path / "train_config.json", lambda raw: raw.update(env=env))
    with pytest.raises(CheckpointError, match=r"allow_code=\['task_of_theirs:TASK'\]"):
        load_lerobot(path)
    assert not marker.exists()
    training = load_lerobot(path, allow_code=["task_of_theirs:TASK"]).training
    assert training is not None
    assert training.env.task == "task_of_theirs:TASK"


@pytest.mark.parametrize(
    ("what", "named"),
    [("domain", "domain_of_theirs:DOMAIN"), ("effects_code", "effects_of_theirs.py")],
)
def test_no_other_python_of_that_environment_runs(
    tmp_path: Path, marker: Path, monkeypatch: pytest.MonkeyPatch, what: str, named: str
) -> None:
    path = copied("smolvla", tmp_path / "theirs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    file = f"{named.partition(':')[0].removesuffix('.py')}.py"
    (tmp_path / file).write_text(f"open({str(marker)!r}, 'w').close()\n")
    config = TrainPipelineConfig(dataset=DatasetConfig(repo_id="theirs/data"))
    config.save_pretrained(path)
    env = {"type": "rlco", what: named}
    edit(path / "train_config.json", lambda raw: raw.update(env=env))
    with pytest.raises(CheckpointError, match=rf"allow_code=\['{named}'\]"):
        load_lerobot(path)
    assert not marker.exists()
