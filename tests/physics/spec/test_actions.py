"""Actions beyond the limits: clipped with one warning, or refused."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from rlco.errors import RlcoError
from rlco.physics.spec.actions import ActionRange


@pytest.fixture
def heard(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> pytest.LogCaptureFixture:
    monkeypatch.setattr(logging.getLogger("rlco"), "propagate", True)
    return caplog


def test_noise_beyond_the_limits_is_warned_of_once(
    heard: pytest.LogCaptureFixture,
) -> None:
    limits = ActionRange()
    limits.check(np.array([[-1.0005, 1.0]]))
    assert not heard.records
    limits.check(np.array([[-1.5, 0.25]]))
    limits.check(np.array([[3.0, 0.25]]))
    (record,) = heard.records
    assert "from -1.5 to 0.25" in record.getMessage()


def test_actions_in_degrees_are_refused() -> None:
    with pytest.raises(RlcoError, match=r"from -57\.3 to 20, .*another unit"):
        ActionRange().check(np.array([[20.0, -57.3]]))
