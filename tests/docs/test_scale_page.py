"""What docs/scale.md reckons follows from the parts that it says were measured."""

from __future__ import annotations

import re

import pytest
from pages import DOCS

TEXT = (DOCS / "scale.md").read_text("utf-8")


def number(pattern: str) -> float:
    """Return the number that a sentence of the page gives."""
    found = re.search(pattern.replace("#", r"([\d,.]*\d)"), TEXT)
    assert found is not None, pattern
    return float(found[1].replace(",", ""))


RATE = number(r"\| # control steps a second and core")
RATIO = number(r"\| # times as fast as playing")
DECISION = number(r"sends it \| # bytes")
POLICY = number(r"that policy \| # kB")
WEIGHTS = number(r"critic's too \| #")
PLAY, LEARN = 2048 / RATE, 2048 / RATE / RATIO
WORKERS, LEARNERS = 64 * 16, 8
STEPS = WORKERS * 2048
NETWORK = 10e9 / 8  # [bytes/s]


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        (r"control steps: # s to play on one core", PLAY),
        (r"and # s to learn from", LEARN),
        (r"the learner still [\d.]+ s: # s become", PLAY + LEARN),
        (r"become # s\s+with 4 workers", PLAY / 4 + LEARN),
        (r"never less than [\d.]+ s, # times as fast", (PLAY + LEARN) / LEARN),
        (r"\| # decisions, ", STEPS / 4),
        (r"decisions, # MB", STEPS / 4 * DECISION / 1e6),
        (r"MB \| # s at 10 Gbit/s into each", STEPS / 4 * DECISION / 2 / NETWORK),
        (r"kB, # MB", WORKERS * POLICY / 1e3),
        (r"MB \| # s at 10 Gbit/s out of each", WORKERS * POLICY * 500 / NETWORK),
        (r"\| # control steps a learner", STEPS / LEARNERS),
        (r"a learner \| # s \|", STEPS / LEARNERS / RATE / RATIO),
        (r"weights, # MB an update", WEIGHTS * 4 / 1e6),
        (r"\| # MB in and out of each", 2 * WEIGHTS * 4 * 7 / 8 / 1e6),
        (r"some # workers", LEARNERS * RATIO),
    ],
)
def test_the_arithmetic_is_right(pattern: str, expected: float) -> None:
    written = number(pattern)
    assert written == pytest.approx(expected, rel=0.045)


def test_a_second_learner_is_worth_more_than_a_fourth_worker() -> None:
    gained = {w: PLAY / w - PLAY / (w + 1) for w in (2, 3)}
    assert gained[2] > LEARN / 2 > gained[3]
