"""Two cameras through the recipes: recorded, imitated, trained by RL, and filmed."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import pytest
from recipe_cases import RL_CO, SFT, refused, start

from rlco.policies import load_policy
from rlco.runs.metrics import read_metrics

CAMERAS = ("agentview", "robot0_eye_in_hand")
BOTH = f"camera={','.join(CAMERAS)}"
SEEN = (BOTH, "image=conv", "image_size=64", "use_environment_state=false")
ONE = [o for o in RL_CO if not o.startswith(("iterations", "critic_iterations"))]


@pytest.mark.thorough
def test_two_cameras_go_through_both_stages(tmp_path: Path) -> None:
    demos, sft, rl = (tmp_path / name for name in ("demos", "sft", "rl"))
    recorded = [BOTH, "image_size=64", "look=random", "episodes=1"]
    start("record_demos", *recorded, f"out={demos}")
    start("sft", f"sim_demos={demos}", "sim_ratio=1", *SFT, *SEEN, f"out={sft}")
    policy, _ = load_policy(sft / "policy")
    assert policy.cameras == CAMERAS
    given = [f"policy={sft / 'policy'}", f"real_demos={demos}", *ONE]
    given += ["iterations=1", "critic_iterations=0", "horizon=32", "look=random"]
    start("rl_co", *given, f"out={rl}")
    (row,) = [r for r in read_metrics(rl / "metrics.csv") if r.get("first_ratio")]
    assert row["first_ratio"] == pytest.approx(1.0, abs=1e-5)
    assert row["grad_norm_real"] > 0
    filmed = [f"policy={rl / 'policy'}", "episodes=1", "videos=1", "look=stand_in"]
    start("evaluate", *filmed, f"out={tmp_path / 'evaluation'}")
    film = imageio.imread(tmp_path / "evaluation" / "videos" / "sim_0.mp4", index=0)
    assert film.shape == (192, 384, 3)  # beside each other, three times enlarged


@pytest.mark.parametrize(
    ("recipe", "options", "words"),
    [
        ("sft", ["camera=agentview,agentview"], ["camera", "each once"]),
        ("record_demos", ["look=random"], ["look=random changes images"]),
        ("record_demos", ["look=dusk", "image_size=64"], ["unknown look 'dusk'"]),
        (
            "record_demos",
            ["camera=agentview,wrist", "image_size=64", "episodes=1"],
            ["unknown camera 'wrist'", "robot0_eye_in_hand"],
        ),
    ],
)
def test_cameras_and_looks_that_cannot_be_are_refused(
    capsys: pytest.CaptureFixture[str],
    recipe: str,
    options: list[str],
    words: list[str],
    tmp_path: Path,
) -> None:
    message = refused(capsys, recipe, *options, f"out={tmp_path / 'out'}")
    for word in words:
        assert word in message
