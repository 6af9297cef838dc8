"""Encoders that learn from labelled scenes, through the recipes."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from recipe_cases import RL_CO, SFT, refused, start
from torch.testing import assert_close

from rlco.policies import load_policy
from rlco.runs.metrics import read_metrics
from rlco.runs.state_files import load_state
from rlco.training.options.stage_one_options import StageOneOptions
from rlco.training.pretraining_checks import say_unlabelled

DENSE = ("image=dense", "image_size=64", "use_environment_state=false")
SCENES = ("pretrain_scenes=70", "pretrain_passes=2")
ONE = [o for o in RL_CO if not o.startswith(("iterations", "critic_iterations"))]


@dataclass(frozen=True)
class Drawn:
    """Demonstrations with images drawn by the rasteriser, as (options, runs)."""

    sim: Path
    real: Path
    fixed: Path
    trained: Path

    @property
    def data(self) -> list[str]:
        return [f"sim_demos={self.sim}", f"real_demos={self.real}"]


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    root = tmp_path_factory.mktemp("drawn")
    made = Drawn(*(root / name for name in ("sim", "real", "fixed", "trained")))
    images = ["episodes=1", "camera=agentview", "image_size=64"]
    start("record_demos", *images, f"out={made.sim}")
    start("record_demos", *images, "domain=stand_in", "seed=1", f"out={made.real}")
    given = [*made.data, *SFT, *DENSE, *SCENES]
    start("sft", *given, "image_fixed=true", f"out={made.fixed}")
    start("sft", *given, "position_coeff=0.5", f"out={made.trained}")
    return made


def image_weights(run: Path) -> dict[str, torch.Tensor]:
    policy, _ = load_policy(run / "policy")
    weights: dict[str, torch.Tensor] = policy.encoder.image.state_dict()
    return weights


def test_a_fixed_encoder_stays_as_it_was_pretrained_and_a_trained_one_does_not(
    drawn: Drawn,
) -> None:
    fixed, trained = image_weights(drawn.fixed), image_weights(drawn.trained)
    one, other = (
        load_state(run / "pretrained") for run in (drawn.fixed, drawn.trained)
    )
    assert_close(one, other, atol=0, rtol=0)
    assert_close(dict(fixed), one["encoders"][0], atol=0, rtol=0)
    assert any(not torch.equal(fixed[name], trained[name]) for name in fixed)
    rows = read_metrics(drawn.trained / "metrics.csv")
    assert all(row["loss_position"] > 0 for row in rows)
    assert "loss_position" not in read_metrics(drawn.fixed / "metrics.csv")[0]
    log = (drawn.fixed / "log.txt").read_text()
    assert " mm on average in 16 new scenes" in log


def test_an_encoder_that_learns_without_labels_is_warned_of(
    drawn: Drawn,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    given = [*drawn.data, *SFT, *DENSE]
    capsys.readouterr()
    start("sft", *given, f"out={tmp_path / 'plain'}")
    assert "image=dense learns from demonstrations alone" in capsys.readouterr().err
    caplog.clear()
    say_unlabelled(StageOneOptions(image="dense", pretrain_scenes=70))
    say_unlabelled(StageOneOptions(image="conv"))
    # Of real demonstrations alone, as real_only of quickstart, which has no scenes.
    say_unlabelled(StageOneOptions(image="dense", sim_ratio=0.0))
    assert not caplog.records


def ends_alike(cut: Path, whole: Path) -> bool:
    files = ("metrics.csv", "policy/policy.safetensors")
    return all((cut / one).read_bytes() == (whole / one).read_bytes() for one in files)


@pytest.mark.parametrize("name", ["fixed", "trained"])
def test_a_resumed_run_ends_alike_and_draws_no_scene_again(
    drawn: Drawn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    whole, cut = getattr(drawn, name), tmp_path / "cut"
    shutil.copytree(whole, cut)
    (cut / "checkpoints" / "step_0000003.safetensors").unlink()
    shutil.rmtree(cut / "policy")
    monkeypatch.setattr("rlco.data.labelled_scenes.labelled_scenes", None)
    start("sft", f"resume={cut}")
    assert ends_alike(cut, whole)


@pytest.mark.thorough
def test_a_run_that_was_stopped_after_pretraining_goes_on_from_it(
    drawn: Drawn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    cut = tmp_path / "cut"
    given = [*drawn.data, *SFT, *DENSE, *SCENES, "position_coeff=0.5", f"out={cut}"]
    with monkeypatch.context() as patched:
        patched.setattr("rlco.training.stage_one.imitate", stop)
        with pytest.raises(SystemExit):
            start("sft", *given)
    monkeypatch.setattr("rlco.data.labelled_scenes.labelled_scenes", None)
    start("sft", f"resume={cut}")
    assert ends_alike(cut, drawn.trained)


@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    ["image_fixed=true", pytest.param("image_lr=0.1", marks=pytest.mark.thorough)],
)
def test_stage_two_from_images_starts_at_ratio_one(
    drawn: Drawn, tmp_path: Path, more: str
) -> None:
    given = [f"policy={drawn.fixed / 'policy'}", f"real_demos={drawn.real}"]
    given += [f"heldout_demos={drawn.real}", *ONE, "iterations=1", "horizon=32"]
    folder = tmp_path / "rl"
    start("rl_co", *given, more, "critic_iterations=0", f"out={folder}")
    _, row = read_metrics(folder / "metrics.csv")
    assert row["first_ratio"] == pytest.approx(1.0, abs=1e-5)
    assert row["grad_norm_real"] > 0
    before, after = image_weights(drawn.fixed), image_weights(folder)
    stays = all(torch.equal(before[name], after[name]) for name in before)
    assert stays == (more == "image_fixed=true")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["pretrain_scenes=5"], ["pretrain_scenes", "image=dense"]),
        (["position_coeff=0.5"], ["position_coeff", "image=dense"]),
        (["image=dense", "image_fixed=true"], ["image_fixed", "pretrain_scenes=4000"]),
        (
            ["image=dense", "image_fixed=true", "position_coeff=1", *SCENES],
            ["position_coeff=1.0", "image_fixed=true"],
        ),
        (
            ["image=dense", "image_fixed=true", "augment=true", *SCENES],
            ["augment=true", "image_fixed=true"],
        ),
        (
            ["image=dense", "position_coeff=1", "sim_ratio=0"],
            ["position_coeff=1.0", "sim_ratio=0"],
        ),
        (
            ["image=dense", "task=robosuite:Lift", *SCENES],
            ["pretrain_scenes=70", "robosuite:Lift"],
        ),
        (["image=dense", "pretrain_domain=mars", *SCENES], ["mars", "stand_in"]),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    drawn: Drawn,
    options: list[str],
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = [*drawn.data, *SFT, f"out={tmp_path / 'no'}", *options]
    message = refused(capsys, "sft", *given)
    assert all(word in message for word in words), message
    assert not (tmp_path / "no").exists()
