"""What draws a policy's images is part of its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rlco.errors import UnknownNameError
from rlco.evaluation import read_by
from rlco.policies import GaussianPolicy, load_policy, save_policy

FIRST_EDITION = Path(__file__).parents[2] / "first_edition" / "policies"


def seeing(**image: Any) -> GaussianPolicy:
    given: Any = {"kind": "conv", "size": (64, 64), **image}
    return GaussianPolicy(7, chunk=4, hidden=(4,), image=given)


def test_a_policy_is_evaluated_with_the_renderer_that_it_was_trained_with(
    tmp_path: Path,
) -> None:
    save_policy(seeing(renderer="raster", camera="agentview"), tmp_path)
    policy, _ = load_policy(tmp_path)
    assert read_by(policy) == {
        "image_size": (64, 64),
        "renderer": "raster",
        "cameras": ("agentview",),
    }
    assert read_by(policy, "opengl")["renderer"] == "opengl"


def test_a_policy_without_the_record_was_trained_with_opengl() -> None:
    policy, _ = load_policy(FIRST_EDITION / "gaussian_image")
    assert policy.renderer == "opengl"
    assert read_by(policy)["renderer"] == "opengl"


def test_a_policy_that_reads_no_images_is_given_none() -> None:
    assert read_by(GaussianPolicy(7, chunk=4)) == {"image_size": None}


def test_a_renderer_that_does_not_exist_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="unknown renderer 'rastr'"):
        seeing(renderer="rastr")
