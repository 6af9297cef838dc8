"""Stage I with a domain flag: trained, saved, evaluated, and refused by Stage II."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from recipe_cases import RL_CO, SFT, Assets, refused, start

from rlco.keys import DOMAIN
from rlco.policies import GaussianPolicy


def test_a_flagged_policy_is_trained_by_its_rows_flags_and_evaluated(
    assets: Assets,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: list[frozenset[float]] = []
    imitation_loss = GaussianPolicy.imitation_loss

    def spy(policy: GaussianPolicy, rows: Any) -> Any:
        if DOMAIN in rows:
            seen.append(frozenset(rows[DOMAIN].flatten().tolist()))
        return imitation_loss(policy, rows)

    monkeypatch.setattr(GaussianPolicy, "imitation_loss", spy)
    given = [f"sim_demos={assets.sim}", f"real_demos={assets.real}", *SFT]
    flag = ["domain_flag=0.5", "guidance=1.5"]
    start("sft", *given, *flag, f"out={tmp_path / 'sft'}")
    # Six updates, each of simulated and then of real rows; half of the flags dropped.
    assert len(seen) == 12
    assert frozenset().union(*seen[::2]) == {-1.0, 0.0}
    assert frozenset().union(*seen[1::2]) == {1.0, 0.0}
    policy = tmp_path / "sft" / "policy"
    content = json.loads((policy / "policy.json").read_text())
    assert content["arguments"]["guidance"] == 1.5
    assert content["extra"]["domain_flag"] == 0.5
    folder = tmp_path / "evaluation"
    more = ["guidance=0", "episodes=1", f"out={folder}"]
    start("evaluate", f"policy={policy}", *more)
    (row,) = json.loads((folder / "results.json").read_text())["rows"]
    assert row["guidance"] == 0.0
    anchor = f"real_demos={assets.real}"
    out = tmp_path / "out"
    line = refused(capsys, "rl_co", f"policy={policy}", anchor, *RL_CO, f"out={out}")
    assert "reads a domain flag" in line
    assert "trained without domain_flag" in line
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["domain_flag=0"], ["domain_flag", "between 0 and 1"]),
        (["domain_flag=1"], ["domain_flag", "between 0 and 1"]),
        (["domain_flag=0.1", "sim_ratio=0"], ["sim_ratio=0 leaves one"]),
        (["domain_flag=0.1", "sim_ratio=1"], ["sim_ratio=1 leaves one"]),
        (["guidance=2"], ["guidance=2.0 needs a flag", "domain_flag=0.1"]),
    ],
)
def test_options_of_the_flag_that_cannot_be_are_refused(
    inputs: dict[str, list[str]],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    options: list[str],
    words: list[str],
) -> None:
    out = tmp_path / "out"
    line = refused(capsys, "sft", *inputs["sft"], *options, f"out={out}")
    for word in words:
        assert word in line
    assert not out.exists()


def test_a_policy_without_a_flag_cannot_be_evaluated_with_guidance(
    assets: Assets, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    given = [f"policy={assets.sft / 'policy'}", "guidance=1.5", f"out={tmp_path / 'o'}"]
    assert "this one reads none" in refused(capsys, "evaluate", *given)
    assert not (tmp_path / "o").exists()
