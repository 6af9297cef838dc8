"""Exact quantiles, and why the stored ones will not do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rlco.data import DemoWriter, exact_quantiles, load_demos
from rlco.errors import ConfigError, DataError
from rlco.keys import ACTION


def test_by_hand() -> None:
    # 5 frames: the quantile q lies at position 4 q between the sorted values.
    values = [[4.0, 0.0], [0.0, 10.0], [1.0, 20.0], [3.0, 30.0], [2.0, 40.0]]
    # 4 * 0.1 = 0.4 and 4 * 0.75 = 3: 0.4 of the first gap, and the fourth value.
    expected = [[0.4, 4.0], [3.0, 30.0]]
    np.testing.assert_allclose(exact_quantiles(values, q=(0.1, 0.75)), expected)


def test_several_sets_count_as_one() -> None:
    rng = np.random.default_rng(0)
    sim, real = rng.normal(size=(700, 3)), rng.normal(5.0, 2.0, size=(41, 3))
    np.testing.assert_array_equal(
        exact_quantiles(sim, real), exact_quantiles(np.concatenate([sim, real]))
    )


def test_float32_data_are_not_rounded_to_float32() -> None:
    values = np.array([[16777216.0], [16777218.0]], np.float32)
    # The midpoint has no float32.
    assert exact_quantiles(values, q=(0.5,)).item() == 16777217.0


def test_stored_quantiles_of_mixed_data_cut_off_half_of_it(tmp_path: Path) -> None:
    """Two kinds of episodes, around -1 and +1, as two tasks or two domains give."""
    rng = np.random.default_rng(0)
    with DemoWriter(
        tmp_path / "mixed", fps=10, state_names=["x"], action_names=["a", "b"]
    ) as writer:
        for episode in range(4):
            centre = -1.0 if episode % 2 else 1.0
            for _ in range(200):
                action = centre + 0.1 * rng.normal(size=2)
                writer.add_frame(state=[0.0], action=action, task="push")
            writer.save_episode()
    stats = json.loads((tmp_path / "mixed/meta/stats.json").read_text())["action"]
    stored = np.array([stats["q01"], stats["q99"]])
    actions = load_demos(tmp_path / "mixed").frames()[ACTION].numpy()
    exact = exact_quantiles(actions)

    def outside(bounds: np.ndarray) -> float:
        return float(np.mean((actions < bounds[0]) | (actions > bounds[1])))

    # An episode around c has q01 = c - 0.233 and q99 = c + 0.233; their means over
    # episodes are -0.233 and 0.233, between the two kinds.
    np.testing.assert_allclose(stored, [[-0.233] * 2, [0.233] * 2], atol=0.05)
    np.testing.assert_allclose(exact, [[-1.2] * 2, [1.2] * 2], atol=0.05)
    assert outside(stored) == 1.0
    assert outside(exact) == pytest.approx(0.02, abs=0.005)


@pytest.mark.parametrize(
    "values",
    [[np.zeros((0, 2))], [np.zeros((3, 2)), np.zeros((3, 1))], [np.zeros(3)], []],
)
def test_shapes_without_quantiles(values: list[np.ndarray]) -> None:
    with pytest.raises(DataError, match="quantiles need data sets of shape"):
        exact_quantiles(*values)


def test_nan_and_bad_levels() -> None:
    with pytest.raises(DataError, match="NaN or infinite"):
        exact_quantiles([[np.nan]])
    with pytest.raises(ConfigError, match=r"q=\(1.5,\) must be quantiles in \[0, 1\]"):
        exact_quantiles([[0.0]], q=(1.5,))
