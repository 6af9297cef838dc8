"""The table of co-training steps."""

from __future__ import annotations

from typing import Any

import pytest
import torch
import vla_step
from vla_models import tiny_openvla


@pytest.mark.slow
def test_what_does_not_fit_says_so_and_the_next_line_follows(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def too_large() -> Any:
        raise torch.cuda.OutOfMemoryError("tried to allocate 62 GiB")

    monkeypatch.setattr(vla_step, "print_counts", lambda: None)
    monkeypatch.setattr(vla_step, "pi05_modes", lambda load: {"too large": too_large})
    config = vla_step.Config(sim_rows=2, real_rows=1, repeats=1, tiny=True)
    vla_step.main(config)
    table = [line for line in capsys.readouterr().out.splitlines() if "|" in line]
    assert table[2] == "| too large | out of memory | - | - | - | - |"
    names = vla_step.openvla_modes(tiny_openvla)
    assert [line.split(" | ")[0] for line in table[3:]] == [f"| {n}" for n in names]
    for line in table[3:]:
        assert float(line.split(" | ")[1]) > 0
