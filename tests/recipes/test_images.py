"""Images through the recipes: recorded, imitated, reinforced, evaluated; refusals."""

from __future__ import annotations

import base64
import gc
import importlib
import io
import json
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from recipe_cases import RL_CO, SFT, Assets, refused, start
from torch.testing import assert_close

from rlco.data import load_demos, load_task_demos
from rlco.errors import RenderingError
from rlco.keys import ENVIRONMENT_STATE, IMAGE
from rlco.physics.spec.domain import make_domain
from rlco.physics.tasks.make_task import make_task
from rlco.policies import load_policy
from rlco.runs.metrics import read_metrics
from rlco.training.options.policy_options import FlowOptions, check_film
from rlco.training.options.stage_two_options import StageTwoOptions
from rlco.training.pretraining_checks import check_pretraining
from rlco.training.stage_one import new_policy
from rlco.training.stage_two import load_stage_two
from rlco.videos import same_scene

SEEN = ("image=conv", "image_size=64")
ONE = [o for o in RL_CO if not o.startswith(("iterations", "critic_iterations"))]


@dataclass(frozen=True)
class Seen:
    """Demonstrations with images of two cameras, and a policy of Stage I on both."""

    sim: Path
    real: Path
    sft: Path


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory, rendering: None) -> Seen:
    root = tmp_path_factory.mktemp("seen")
    made = Seen(root / "sim", root / "real", root / "sft")
    start(
        "record_demos", "episodes=1", "camera=agentview", "image_size=64", out(made.sim)
    )
    # As on a robot: larger images, video, and nobody tells where objects are. In the
    # look of sim, so that images can be compared.
    larger = ["camera=agentview", "image_size=80", "video=true", "domain=stand_in"]
    larger.append("look=sim")
    start("record_demos", "episodes=1", "seed=1", *larger, out(made.real))
    forget_poses(made.real)
    given = [f"sim_demos={made.sim}", f"real_demos={made.real}", *SFT, *SEEN]
    more = ["use_environment_state=false", "augment=true"]
    start("sft", *given, *more, out(made.sft))
    return made


def out(folder: Path) -> str:
    return f"out={folder}"


def forget_poses(folder: Path) -> None:
    """Take the object poses out of what describes a data set."""
    info = folder / "meta" / "info.json"
    content = json.loads(info.read_text())
    del content["features"]["observation.environment_state"]
    info.write_text(json.dumps(content))


@pytest.mark.slow
def test_recorded_pictures_are_read_back(seen: Seen) -> None:
    sim = load_demos(seen.sim)
    assert sim.meta.image_key == "observation.images.agentview"
    assert sim.frames()[IMAGE].shape == (len(sim), 3, 64, 64)
    real = load_demos(seen.real, image_size=(64, 64)).frames()[IMAGE].float()
    assert real.shape[1:] == (3, 64, 64)
    # The same table from nearly the same place: most of the image is alike.
    difference = (real[0] - sim.frames()[IMAGE][0].float()).abs()
    assert float(difference.median()) < 20


def test_many_pictures_are_mapped_from_a_file_that_goes_with_them(
    seen: Seen, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    task = make_task("push_cube")
    options: dict[str, Any] = {"chunk": 2, "image_size": (64, 64)}
    in_memory = load_task_demos(seen.sim, task, **options).frames()[IMAGE]
    monkeypatch.setattr("rlco.data.task_demos.IN_MEMORY", 1000)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    mapped = load_task_demos(seen.sim, task, **options)
    assert list(tmp_path.rglob("*.memmap"))
    assert torch.equal(mapped.frames()[IMAGE], in_memory)
    del mapped
    gc.collect()
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_policy_that_sees_goes_through_stage_two_and_is_filmed(
    seen: Seen, tmp_path: Path
) -> None:
    policy, _ = load_policy(seen.sft / "policy")
    assert IMAGE in policy.in_keys
    assert ENVIRONMENT_STATE not in policy.in_keys
    given = [f"policy={seen.sft / 'policy'}", f"real_demos={seen.real}"]
    given += [f"heldout_demos={seen.real}", *ONE, "iterations=1", "horizon=32"]
    folder = tmp_path / "rl"
    start("rl_co", *given, "augment=true", "critic_iterations=0", out(folder))
    before, row = read_metrics(folder / "metrics.csv")
    assert row["first_ratio"] == pytest.approx(1.0, abs=1e-5)
    assert row["grad_norm_real"] > 0
    assert row["imitation_error_heldout"] != before["imitation_error_heldout"]
    filmed = [f"policy={folder / 'policy'}", "episodes=1", "videos=1"]
    start("evaluate", *filmed, "renderer=opengl", out(tmp_path / "evaluation"))
    assert (tmp_path / "evaluation" / "videos" / "sim_0.mp4").stat().st_size > 1000
    (row,) = json.loads((tmp_path / "evaluation" / "results.json").read_text())["rows"]
    assert row["renderer"] == "opengl"


def test_rl_in_the_look_of_final_tables_is_refused(
    seen: Seen, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    given = [f"policy={seen.sft / 'policy'}", "real_coeff=0", "look=locked"]
    line = refused(capsys, "rl_co", *given, out(tmp_path / "rl"))
    assert "look=locked is for final evaluations alone" in line
    assert "look=random" in line
    assert not (tmp_path / "rl").exists()


def test_a_renderer_for_a_policy_that_reads_no_images_is_refused(
    assets: Assets, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    given = [f"policy={assets.sft / 'policy'}", "renderer=raster"]
    line = refused(capsys, "evaluate", *given, out(tmp_path / "evaluation"))
    assert "renderer=raster draws what a policy reads" in line


def test_only_films_by_opengl_need_it(
    seen: Seen, assets: Assets, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> None:
        raise RenderingError("egl", "not found")

    monkeypatch.setattr("rlco.physics.rendering.renderers.check_rendering", fail)
    by_raster, _ = load_policy(seen.sft / "policy")
    on_poses, _ = load_policy(assets.sft / "policy")
    check_film(by_raster)
    for given in [(by_raster, "opengl"), (on_poses,)]:
        with pytest.raises(RenderingError):
            check_film(*given)


def test_stage_two_tells_of_demonstrations_drawn_otherwise(
    seen: Seen, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    other = tmp_path / "real"
    shutil.copytree(seen.real, other)
    recorded = other / "meta" / "rlco.json"
    content = json.loads(recorded.read_text())
    recorded.write_text(json.dumps({**content, "renderer": "opengl"}))
    options = StageTwoOptions(
        policy=str(seen.sft / "policy"),
        real_demos=str(seen.real),
        heldout_demos=str(other),
    )
    load_stage_two(options)
    (said,) = [r.getMessage() for r in caplog.records if "was drawn" in r.getMessage()]
    assert said.startswith(f"{other} was drawn by renderer=opengl")


def test_a_resumed_run_draws_the_same_shifts(seen: Seen, tmp_path: Path) -> None:
    cut = tmp_path / "cut"
    shutil.copytree(seen.sft, cut)
    (cut / "checkpoints" / "step_0000003.safetensors").unlink()
    shutil.rmtree(cut / "policy")
    start("sft", f"resume={cut}")
    for name in ("metrics.csv", "policy/policy.safetensors"):
        assert (cut / name).read_bytes() == (seen.sft / name).read_bytes(), name


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["image=conv", "image_size=32"], ["image_size", "64"]),
        (
            ["image=conv", "image_size=128"],
            ["too small", "(128, 128)", "record larger"],
        ),
        (["image=cnn"], ["'none'", "'conv'", "'mobilenet'"]),
        (["image=mobilenet"], ["image_weights=mobilenet_v2-b0353104.pth"]),
        (["image=mobilenet", "image_weights=no.pth"], ["is missing", "'no.pth'"]),
        (["image_weights=no.pth"], ["image_weights", "image=mobilenet"]),
        (
            ["camera=robot0_eye_in_hand", "image_size=128"],
            ["camera=robot0_eye_in_hand is of images", "image_size=128", "image=dense"],
        ),
        (["image_frozen=false"], ["image_frozen=false is of images"]),
        (
            ["image=dense", "pretrain_passes=30"],
            ["pretrain_passes=30 is of labelled scenes", "pretrain_scenes=8000"],
        ),
        (["augment=true"], ["augment=true", "image=conv"]),
        (["use_environment_state=false"], ["use_environment_state", "image=conv"]),
        ([*SEEN, "real_camera=front"], ["no camera 'front'", "agentview"]),
        ([*SEEN], ["no feature 'observation.environment_state'"]),
    ],
)
def test_options_of_pictures_that_cannot_be(
    seen: Seen,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    options: list[str],
    words: list[str],
) -> None:
    given = [f"sim_demos={seen.sim}", f"real_demos={seen.real}", *SFT]
    line = refused(capsys, "sft", *given, *options, out(tmp_path / "out"))
    for word in words:
        assert word in line
    assert not (tmp_path / "out").exists()


def test_a_camera_that_evaluations_lack_is_refused_before_training(
    seen: Seen, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    # Real data of one camera, whatever it is called there.
    given = [f"real_demos={seen.real}", "sim_ratio=0", *SEEN, "camera=agentviw"]
    blind = "use_environment_state=false"
    line = refused(capsys, "sft", *given, blind, out(tmp_path / "out"))
    assert "unknown camera 'agentviw'" in line
    assert "mean 'agentview'" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("recipe", "options", "words"),
    [
        ("record_demos", ["camera=agentview"], ["camera and image_size", "both"]),
        ("record_demos", ["image_size=64"], ["camera and image_size", "both"]),
        ("record_demos", ["video=true"], ["video=true is of images", "camera="]),
        (
            "quickstart",
            ["image=dense", "camera=agentviw"],
            ["unknown camera 'agentviw'", "mean 'agentview'"],
        ),
        ("quickstart", ["image=mobilenet"], ["image_weights="]),
        ("quickstart", ["augment=true"], ["augment=true", "image=conv"]),
        ("quickstart", ["policy=token", "token.heads=3"], ["heads must divide width"]),
        ("close_loop", ["policy=token", "token.heads=3"], ["heads must divide width"]),
    ],
)
def test_refused_before_a_folder_is_made(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    recipe: str,
    options: list[str],
    words: list[str],
) -> None:
    line = refused(capsys, recipe, *options, out(tmp_path / "out"))
    for word in words:
        assert word in line
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("rendering")
def test_a_camera_that_is_not_there_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    options = "camera=agentviw", "image_size=64", out(tmp_path / "out")
    assert "mean 'agentview'" in refused(capsys, "record_demos", *options)
    assert not (tmp_path / "out").exists()


def test_quickstart_hands_its_options_on() -> None:
    quickstart: Any = importlib.import_module("quickstart")
    flow = FlowOptions(steps=2)
    config = quickstart.Config(
        policy="flow",
        flow=flow,
        image="conv",
        augment=True,
        eval_domains=["sim"],
        train_domain="stand_in",
        effects_code="mine.py",
    )
    nowhere = {"sim": "", "real": "", "heldout": ""}
    one = quickstart.stage_one(config, nowhere, "sft")
    policy = new_policy(one)
    assert (policy.kind, policy.chain.steps) == ("flow", 2)
    assert policy.image_size == (64, 64)
    two = quickstart.stage_two(config, Path(), nowhere, "rl_co")
    assert two.train_domain == "stand_in"
    for stage in (one, two):
        assert stage.augment
        assert stage.eval_domains == ["sim"]
        assert stage.effects_code == "mine.py"


def test_quickstart_draws_labelled_scenes_where_rl_trains() -> None:
    quickstart: Any = importlib.import_module("quickstart")
    nowhere = {"sim": "", "real": "", "heldout": ""}
    given = {"image": "dense", "pretrain_passes": 15, "train_domain": "stand_in"}
    config = quickstart.Config(**given, pretrain_scenes=8000)
    one = quickstart.stage_one(config, nowhere, "sft")
    assert (one.pretrain_scenes, one.pretrain_domain) == (8000, "stand_in")
    # Nothing is said of passes that nobody gave, and none are made.
    for without in (
        quickstart.stage_one(config, nowhere, "real_only"),
        quickstart.stage_one(quickstart.Config(**given), nowhere, "sft"),
    ):
        assert without.pretrain_scenes == 0
        check_pretraining(without)


def test_a_scene_is_the_same_in_every_domain() -> None:
    sim = make_domain("sim")
    cameras = ("agentview", "robot0_eye_in_hand")
    seen = same_scene("push_cube", (sim, replace(sim, name="twin")), cameras=cameras)
    for camera in cameras:
        assert np.array_equal(seen[camera]["sim"], seen[camera]["twin"])
    assert len(np.unique(seen["agentview"]["sim"])) > 20
    (other,) = same_scene("push_cube", ("sim",), index=1)["agentview"].values()
    assert not np.array_equal(other, seen["agentview"]["sim"])


@pytest.mark.slow
@pytest.mark.thorough
def test_quickstart_tells_its_story_from_images_alone(tmp_path: Path) -> None:
    folder = tmp_path / "quick"
    few = ["sim_demos=1", "real_demos=1", "heldout_demos=1", "updates=2", "film=false"]
    few += ["pretrain_scenes=8", "pretrain_passes=1", "methods=[rl_co]"]
    few += ["iterations=1", "num_envs=2", "eval_every=1", "curve_episodes=1"]
    few += ["eval_domains=[sim]", "eval_episodes=1"]
    start("quickstart", "image=dense", *few, out(folder))
    policy, _ = load_policy(folder / "stages" / "rl_co" / "policy")
    assert list(policy.cameras) == ["agentview", "robot0_eye_in_hand"]
    assert ENVIRONMENT_STATE not in policy.in_keys
    fixed = [
        load_policy(folder / "stages" / one / "policy")[0].encoder.image.state_dict()
        for one in ("sft", "rl_co")
    ]
    assert_close(dict(fixed[0]), dict(fixed[1]), atol=0, rtol=0)
    page = (folder / "report.html").read_text()
    assert "nothing tells them where objects are" in page
    assert "learned where things are from 8 labelled scenes of sim" in page
    (scene,) = re.findall(
        r'<img src="data:image/png;base64,([^"]*)" alt="The same', page
    )
    assert base64.b64decode(scene) == (folder / "plots/same_scene.png").read_bytes()
    with Image.open(io.BytesIO(base64.b64decode(scene))) as image:
        said = image.info["Description"]
    assert "agentview and robot0_eye_in_hand" in said
    assert "in sim (the simulator as built) and in stand_in (a second sim" in said


def test_data_and_policies_without_pictures(
    assets: Assets, seen: Seen, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = out(tmp_path / "out")
    given = [f"sim_demos={assets.sim}", f"real_demos={assets.real}", *SFT, *SEEN]
    line = refused(capsys, "sft", *given, folder)
    assert "has no images" in line
    assert str(assets.sim) in line
    policy = f"policy={seen.sft / 'policy'}"
    line = refused(capsys, "rl_co", policy, f"real_demos={assets.real}", *ONE, folder)
    assert "has no images" in line
    plain = [f"policy={assets.sft / 'policy'}", f"real_demos={assets.real}"]
    line = refused(capsys, "rl_co", *plain, *ONE, "augment=true", folder)
    assert "reads none" in line
    rest = [o for o in SFT if not o.startswith("eval_episodes")]
    lift = ["task=robosuite:Lift", "eval_domains=[sim]", *rest, *SEEN]
    line = refused(capsys, "sft", f"sim_demos={seen.sim}", "sim_ratio=1", *lift, folder)
    assert "images are not supported for 'robosuite:Lift'" in line
    assert not (tmp_path / "out").exists()
