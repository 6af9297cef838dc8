"""The page on environments shows what runs."""

from __future__ import annotations

from pages import run_python


def test_another_environment_gives_what_the_loss_reads() -> None:
    made = run_python("environments.md", "## Train on it")
    sim = made["sim"]
    assert sim.batch_size == (20,)
    assert sim["advantage"].shape == sim["value_target"].shape == (20, 1)
    assert sim["advantage"].abs().sum() > 0
