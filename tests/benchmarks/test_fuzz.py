"""A slice of benchmarks/fuzz.py: damaged files are read, or refused in a sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz import attempt, whole_files
from fuzz_files import READERS

#: Damaged inputs of each reader.
INPUTS = 6


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    whole = whole_files(name, tmp_path)
    for seed in range(INPUTS):
        outcome, said = attempt(name, whole, seed)
        assert outcome in ("read", "refused"), f"seed {seed}: {outcome} {said}"
