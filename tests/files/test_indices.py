"""Indices as short text."""

from __future__ import annotations

import pytest

from rlco.errors import ConfigError
from rlco.files.indices import index_list


@pytest.mark.parametrize("text", ["0-999999999999", "3-1", "a", "1,,2", "²"])
def test_text_that_is_no_list_of_indices(text: str) -> None:
    with pytest.raises(ConfigError, match=r"episodes=.* is no list of indices"):
        index_list(text)
