"""Training from images in a process that can load no OpenGL library."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from recipe_cases import RL_CO, SFT

HERE = Path(__file__).parent
# Whoever asks for a library is told that there is none, and MuJoCo has no context.
PROLOGUE = """
import ctypes, ctypes.util, sys
find, load = ctypes.util.find_library, ctypes.CDLL
NAMES = ("EGL", "OSMesa", "GL")
ctypes.util.find_library = lambda name: None if name in NAMES else find(name)
class Refusing(load):
    def __init__(self, name, *args, **kwargs):
        if name and any(f"lib{n}." in str(name) for n in NAMES):
            raise OSError(f"{name}: blocked")
        super().__init__(name, *args, **kwargs)
ctypes.CDLL = Refusing
sys.modules["OpenGL"] = None
from rlco.errors import RenderingError
from rlco.physics.rendering.camera import check_rendering
try:
    check_rendering()
except RenderingError:
    print("no OpenGL here")
else:
    raise SystemExit("OpenGL was loaded")
"""


def without_opengl(script: str, *arguments: str) -> str:
    """Run a script where OpenGL cannot be loaded; return what it printed."""
    paths = [str(HERE), str(HERE.parents[1] / "recipes")]
    environment = {
        **os.environ,
        "MUJOCO_GL": "disable",
        "PYTHONPATH": os.pathsep.join(paths),
    }
    done = subprocess.run(
        [sys.executable, "-c", PROLOGUE + script, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "no OpenGL here" in done.stdout
    return done.stdout


def test_an_environment_draws_without_opengl() -> None:
    script = """
from rlco.envs import make_env
env = make_env("push_cube", image_size=(64, 64), renderer="raster")
image = env.reset()["observation", "image"]
print(len(image.unique()) > 50)
"""
    assert without_opengl(script).endswith("True\n")


@pytest.mark.slow
@pytest.mark.thorough
def test_both_stages_train_from_images_without_opengl(tmp_path: Path) -> None:
    demos, first, second = (tmp_path / name for name in ("demos", "sft", "rl_co"))
    # The recommended encoder: its labelled scenes are drawn here, too.
    seen = ["image=dense", "image_fixed=true", "use_environment_state=false"]
    seen += ["pretrain_scenes=16", "pretrain_passes=1"]
    calls = {
        "record_demos": ["episodes=1", "camera=agentview", "image_size=64", demos],
        "sft": [f"sim_demos={demos}", f"real_demos={demos}", *SFT, *seen, first],
        "rl_co": [
            f"policy={first / 'policy'}",
            f"real_demos={demos}",
            *RL_CO,
            "image_fixed=true",
            second,
        ],
    }
    script = (
        "import rlco.training.pretraining\n"
        "rlco.training.pretraining.HELD_OUT = 4\n"  # of 400: to draw them takes longer
        "from recipe_cases import start\n"
    )
    script += "".join(
        f"start({name!r}, *{[*map(str, given[:-1]), f'out={given[-1]}']!r})\n"
        for name, given in calls.items()
    )
    without_opengl(script)
    for folder in (first, second):
        policy = json.loads((folder / "policy" / "policy.json").read_text())
        assert policy["arguments"]["image"] == {
            "kind": "dense",
            "size": [64, 64],
            "renderer": "raster",
            "camera": "agentview",
        }
