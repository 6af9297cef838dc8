"""Arguments of `make_env` that are wrong, or would be of no effect, are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from rlco.envs import make_env
from rlco.errors import RlcoError
from rlco.physics.tasks.make_task import make_task

PLAIN = replace(make_task("push_cube"), variations=())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"task": "push_cub"}, "unknown task 'push_cub' .*did you mean 'push_cube'"),
        ({"domain": "stand_inn"}, "unknown domain .*did you mean 'stand_in'"),
        ({"backend": "nativ"}, "unknown backend 'nativ' .*did you mean 'native'"),
        ({"reward": "spare"}, "unknown reward 'spare' .*did you mean 'sparse'"),
        ({"variation": "far"}, "unknown variation 'far'; known: shapes, colours"),
        ({"num_envs": 0}, "num_envs=0 is not allowed; give 1 or more"),
        ({"chunk": 0}, "chunk=0 is not allowed; give 1 or more"),
        ({"horizon": -3}, "horizon=-3 is not allowed; give 1 or more"),
        ({"seed": -1}, "seed=-1 is not allowed; give 0 or more"),
        ({"image_size": 64}, r"image_size=64 is not allowed; give \(height, width\)"),
        ({"image_size": (0, 64)}, r"image_size=\(0, 64\) is not allowed"),
        (
            {"task": PLAIN, "variation": "shapes"},
            "unknown variation 'shapes'; known: none",
        ),
        ({"threads": 0}, "threads=0 is not allowed; give 1 or more"),
        ({"threads": -3}, "threads=-3 is not allowed; give 1 or more"),
        (
            {"threads": 2, "backend": "robosuite"},
            "threads=2 is for backend='native'; backend='robosuite' steps one",
        ),
        (
            {"exact": True, "backend": "robosuite"},
            "exact=True is for backend='native'; .* leave it out",
        ),
        (
            {"image_quality": "robosuite"},
            "image_quality='robosuite' is of no use without images; give image_size=",
        ),
        ({"effects": {"lag": 1}}, "give the path of an effects.yaml, or a list"),
    ],
)
def test_wrong_arguments_are_refused_in_one_sentence(
    wrong: dict[str, Any], message: str
) -> None:
    with pytest.raises(RlcoError, match=message) as caught:
        make_env(**{"task": "push_cube", **wrong})
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith(".")
