"""The recipes one after the other: record, imitate, reinforce, evaluate, compare."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from recipe_cases import RECIPES, RL_CO, Assets, refused, start
from torch.optim.optimizer import register_optimizer_step_pre_hook

import rlco.evaluation
from rlco.evaluation import EVALUATION_SEED, final_states_seed
from rlco.policies import load_policy
from rlco.run import Run
from rlco.runs.metrics import read_metrics
from rlco.runs.state_files import rng_state

pytestmark = pytest.mark.slow

# Stage II is resumed from a kill below, to the same metrics.
STAGES = pytest.mark.parametrize(
    "stage", ["sft", pytest.param("rl_co", marks=pytest.mark.thorough)]
)


def test_recording_again_gives_the_same_data(assets: Assets, tmp_path: Path) -> None:
    again = tmp_path / "again"
    start("record_demos", "domain=stand_in", "episodes=2", f"out={again}")
    for file in (assets.real / "data").rglob("*.parquet"):
        other = again / file.relative_to(assets.real)
        assert other.read_bytes() == file.read_bytes()


@STAGES
def test_the_same_seed_gives_the_same_metrics(
    assets: Assets, inputs: dict[str, list[str]], tmp_path: Path, stage: str
) -> None:
    start(stage, *inputs[stage], f"out={tmp_path / 'again'}")
    first = (getattr(assets, stage) / "metrics.csv").read_bytes()
    assert (tmp_path / "again" / "metrics.csv").read_bytes() == first

    start(stage, *inputs[stage], f"out={tmp_path / 'other'}", "seed=1")
    assert (tmp_path / "other" / "metrics.csv").read_bytes() != first


class KilledError(Exception):
    """Stands for whatever ends a process between a row and its checkpoint."""


def seen(optimizer: torch.optim.Optimizer) -> str:
    """Return the digest of weights, gradients, moments, rates and random numbers.

    The gradients are of the batch just drawn: equal ones show an equal batch.
    """
    state = rng_state()
    digest = hashlib.sha256(
        repr((state["python"], state["numpy"], state["torch"].tolist())).encode()
    )
    for group in optimizer.param_groups:
        rates = {k: v for k, v in group.items() if k != "params"}
        digest.update(repr(sorted(rates.items())).encode())
        for weights in group["params"]:
            moments = optimizer.state.get(weights, {})
            for one in (weights.detach(), weights.grad, *moments.values()):
                digest.update(repr(None if one is None else one.tolist()).encode())
    return digest.hexdigest()


@STAGES
def test_a_run_that_was_cut_off_and_resumed_equals_one_that_was_not(
    assets: Assets,
    inputs: dict[str, list[str]],
    tmp_path: Path,
    stage: str,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    folder = tmp_path / "cut"
    save = Run.save_checkpoint
    # Before each step of an optimiser, all that decides what it does.
    steps: list[str] = []

    def save_once(run: Run, step: int, state: Any, **options: Any) -> Path:
        if step == 2:  # its row of metrics.csv is written, its checkpoint is not
            raise KilledError
        steps.clear()
        return save(run, step, state, **options)

    hook = register_optimizer_step_pre_hook(lambda *given: steps.append(seen(given[0])))
    request.addfinalizer(hook.remove)
    with monkeypatch.context() as patch:
        patch.setattr(Run, "save_checkpoint", save_once)
        with pytest.raises(KilledError):
            start(stage, *inputs[stage], f"out={folder}")
    assert not (folder / "policy").exists()
    continued = list(steps)  # iteration 2 of the very run that was cut off
    assert continued

    def compare(run: Run, step: int, state: Any, **options: Any) -> Path:
        if step == 2:
            assert steps == continued
        return save(run, step, state, **options)

    steps.clear()
    with monkeypatch.context() as patch:
        patch.setattr(Run, "save_checkpoint", compare)
        start(stage, f"resume={folder}")
    whole = getattr(assets, stage)
    for name in ("metrics.csv", "policy/policy.safetensors"):
        assert (folder / name).read_bytes() == (whole / name).read_bytes(), name


def test_a_killed_process_is_resumed_to_the_same_metrics(
    inputs: dict[str, list[str]], tmp_path: Path
) -> None:
    options = [*inputs["sft"], "updates=400", "log_every=40"]
    options = [o for o in options if o not in ("updates=6", "log_every=2")]
    folder = tmp_path / "killed"
    process = subprocess.Popen(
        [sys.executable, str(RECIPES / "sft.py"), *options, f"out={folder}"],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 120
    while not list(folder.glob("checkpoints/step_*2.safetensors")):
        assert process.poll() is None, "it ended before its second checkpoint"
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (folder / "policy").exists()

    start("sft", f"resume={folder}")
    start("sft", *options, f"out={tmp_path / 'whole'}")
    whole = (tmp_path / "whole" / "metrics.csv").read_bytes()
    assert (folder / "metrics.csv").read_bytes() == whole
    assert len(read_metrics(folder / "metrics.csv")) == 10


def test_stage_one_reports_both_terms_and_stage_two_their_gradients(
    assets: Assets,
) -> None:
    one = read_metrics(assets.sft / "metrics.csv")
    assert [row["step"] for row in one] == [1, 2, 3]
    assert [row["updates"] for row in one] == [2, 4, 6]
    assert all({"loss_bc", "loss_bc_real"} <= row.keys() for row in one)

    two = read_metrics(assets.rl_co / "metrics.csv")
    # Two episodes of 64 control steps a rollout, the default training horizon.
    assert [row["frames"] for row in two] == [0, 128, 256, 384]
    for row in two[1:]:
        assert row["first_ratio"] == pytest.approx(1.0, abs=1e-5)
        assert row["grad_norm_sim"] > 0.0
        assert row["grad_norm_real"] > 0.0
        assert -1.0 <= row["grad_cosine"] <= 1.0
    # Success is measured before the first, after every second and after the last.
    assert [row["step"] for row in two if "success_sim" in row] == [0, 2, 3]
    # The first rollout trains the critic alone: the policy forgets nothing.
    errors = [row["imitation_error_heldout"] for row in two]
    assert errors[1] == errors[0]
    assert errors[2] != errors[1]


def test_without_an_anchor_no_demonstrations_are_read(
    assets: Assets, tmp_path: Path
) -> None:
    folder = tmp_path / "rl_only"
    options = ["real_coeff=0", "iterations=1", f"policy={assets.sft / 'policy'}"]
    rest = [o for o in RL_CO if not o.startswith("iterations")]
    start("rl_co", *rest, *options, f"out={folder}")
    last = read_metrics(folder / "metrics.csv")[-1]
    assert "grad_norm_real" not in last
    assert "loss_bc_real" not in last
    assert last["first_ratio"] == pytest.approx(1.0, abs=1e-5)


# -- keep=best ---------------------------------------------------------------------

# One more rollout than RL_CO, an evaluation after each. With a learning rate that falls
# a shorter run learns otherwise from the start.
BEST = ("keep=best", "iterations=4", "eval_every=1", "lr_final=1")


def rates_of(monkeypatch: pytest.MonkeyPatch, rates: list[float]) -> None:
    """Let the evaluations of a run measure these rates, by the rollout."""

    def success_rates(*given: Any) -> dict[str, float]:
        return {"success_sim": rates[given[3]]}

    monkeypatch.setattr(rlco.evaluation, "success_rates", success_rates)


def kept(inputs: dict[str, list[str]]) -> list[str]:
    names = ("iterations", "eval_every")
    return [*(o for o in inputs["rl_co"] if o.split("=")[0] not in names), *BEST]


def weights(folder: Path) -> bytes:
    return (folder / "policy.safetensors").read_bytes()


@pytest.mark.thorough
def test_the_policy_of_the_best_evaluation_is_kept(
    inputs: dict[str, list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, shorter = tmp_path / "best", tmp_path / "shorter"
    # Rollouts 2 and 3 are equal: the earlier one counts.
    rates_of(monkeypatch, [0.25, 0.0, 0.75, 0.75, 0.5])
    start("rl_co", *kept(inputs), f"out={folder}")
    last = [o for o in kept(inputs) if o not in BEST]
    shorter_by_two = ("eval_every=1", "iterations=2", "lr_final=1")
    start("rl_co", *last, *shorter_by_two, f"out={shorter}")
    assert weights(folder / "policy") == weights(shorter / "policy")
    start("rl_co", f"resume={shorter}", "iterations=4")
    assert weights(folder / "policy_last") == weights(shorter / "policy")
    for name in ("policy", "policy_last"):
        extra = load_policy(folder / name)[1]
        chosen = {k: v for k, v in extra.items() if k.startswith(("keep", "kept"))}
        best = {"keep": "best", "kept_rollout": 2, "kept_success_sim": 0.75}
        assert chosen == (best if name == "policy" else {})
    log = (folder / "log.txt").read_text()
    assert "keep=best: the policy of rollout 2, success_sim 75.0 %" in log
    rows = json.loads((folder / "results.json").read_text())["rows"]
    assert [row["method"] for row in rows] == ["rl_co", "rl_co_best"]
    assert (folder / "metrics.csv").read_bytes() == (
        shorter / "metrics.csv"
    ).read_bytes()


BEST_IS_FIRST = [0.25, 0.75, 0.0, 0.5, 0.25]


@pytest.fixture(scope="module")
def whole(
    inputs: dict[str, list[str]], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("best") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        rates_of(patch, BEST_IS_FIRST)
        start("rl_co", *kept(inputs), f"out={folder}")
    return folder


@pytest.mark.thorough
@pytest.mark.parametrize("killed_at", [2, 4])
def test_a_killed_run_keeps_the_same_best_policy(
    inputs: dict[str, list[str]],
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    killed_at: int,
) -> None:
    cut = tmp_path / "cut"
    rates_of(monkeypatch, BEST_IS_FIRST)  # that is before both
    save = Run.save_checkpoint

    def save_once(run: Run, step: int, state: Any, **options: Any) -> Path:
        if step == killed_at:
            raise KilledError
        return save(run, step, state, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Run, "save_checkpoint", save_once)
        with pytest.raises(KilledError):
            start("rl_co", *kept(inputs), f"out={cut}")
    start("rl_co", f"resume={cut}")
    for name in ("metrics.csv", "policy/policy.safetensors", "policy/policy.json"):
        assert (cut / name).read_bytes() == (whole / name).read_bytes(), name
    assert load_policy(cut / "policy")[1]["kept_rollout"] == 1
    assert weights(cut / "policy_last") == weights(whole / "policy_last")
    assert weights(cut / "policy_last") != weights(cut / "policy")


@pytest.mark.thorough
def test_a_start_that_is_never_beaten_is_kept(
    assets: Assets,
    inputs: dict[str, list[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rates_of(monkeypatch, [0.5, 0.0, 0.5, 0.25, 0.5])
    start("rl_co", *kept(inputs), f"out={tmp_path / 'best'}")
    assert weights(tmp_path / "best" / "policy") == weights(assets.sft / "policy")


@pytest.mark.parametrize("option", ["eval_domains=[stand_in]", "eval_episodes=0"])
def test_the_best_is_chosen_only_by_what_is_measured(
    inputs: dict[str, list[str]],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    option: str,
) -> None:
    name = option.split("=")[0]
    given = [o for o in kept(inputs) if o.split("=")[0] != name]
    out = tmp_path / "out"
    line = refused(capsys, "rl_co", *given, option, f"out={out}")
    assert "keep=best chooses by success in the training domain" in line
    assert not out.exists()


def test_rows_of_a_seed_are_of_the_same_initial_states(
    assets: Assets, inputs: dict[str, list[str]], tmp_path: Path
) -> None:
    (row,) = json.loads((assets.rl_co / "results.json").read_text())["rows"]
    assert row["method"] == "rl_co"
    assert row["states_seed"] == final_states_seed(row["seed"]) != EVALUATION_SEED
    assert sum(row["outcomes"]) == row["successes"]
    assert len(row["outcomes"]) == len(row["ever"]) == row["episodes"] == 2
    given = [f"policy={assets.rl_co / 'policy'}", f"seed={row['seed']}", "method=rl_co"]
    start("evaluate", *given, "domain=sim", "episodes=2", f"out={tmp_path / 'again'}")
    (again,) = json.loads((tmp_path / "again" / "results.json").read_text())["rows"]
    assert again == row
    given = [o for o in inputs["sft"] if not o.startswith(("updates", "eval_"))]
    given += ["updates=1", "eval_episodes=1", "eval_domains=[sim]"]
    start("sft", *given, f"out={tmp_path / 'sft'}")
    (sft,) = json.loads((tmp_path / "sft" / "results.json").read_text())["rows"]
    assert sft["states_seed"] == final_states_seed(sft["seed"])


@pytest.mark.thorough
def test_the_last_evaluation_may_be_longer_than_those_of_the_curve(
    inputs: dict[str, list[str]], tmp_path: Path
) -> None:
    given = [o for o in inputs["rl_co"] if not o.startswith("eval_episodes")]
    out = tmp_path / "out"
    more = ["eval_episodes=1", "final_episodes=3", "final_domains=[locked]"]
    start("rl_co", *given, *more, f"out={out}")
    rows = json.loads((out / "results.json").read_text())["rows"]
    assert [row["domain"] for row in rows] == ["sim", "locked"]
    assert [len(row["outcomes"]) for row in rows] == [3, 3]
    last = read_metrics(out / "metrics.csv")[-1]
    assert last["success_sim"] in (0.0, 1.0)
    assert "success_locked" not in last


@pytest.mark.thorough
def test_there_may_be_a_last_evaluation_alone(
    inputs: dict[str, list[str]], tmp_path: Path
) -> None:
    given = [o for o in inputs["rl_co"] if not o.startswith("eval_episodes")]
    out = tmp_path / "out"
    start("rl_co", *given, "eval_episodes=0", "final_episodes=1", f"out={out}")
    (row,) = json.loads((out / "results.json").read_text())["rows"]
    assert row["episodes"] == 1
    assert "success_sim" not in read_metrics(out / "metrics.csv")[-1]


def test_evaluate_writes_what_it_counted(assets: Assets, tmp_path: Path) -> None:
    folder = tmp_path / "evaluation"
    start(
        "evaluate",
        f"policy={assets.rl_co / 'policy'}",
        "domain=stand_in",
        "episodes=3",
        "method=rl_co",
        f"out={folder}",
    )
    results = json.loads((folder / "results.json").read_text())
    assert results["seconds"] > 0
    (row,) = results["rows"]
    wanted = {"method": "rl_co", "domain": "stand_in", "episodes": 3, "seed": 0}
    assert wanted.items() <= row.items()
    assert len(row["outcomes"]) == 3
    assert row["successes"] == sum(row["outcomes"])
    assert row["lost"] == sum(row["ever"]) - sum(row["outcomes"])


def test_quickstart_runs_to_its_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "quick"
    start(
        "quickstart",
        f"out={folder}",
        "sim_demos=1",
        "real_demos=1",
        "heldout_demos=1",
        "updates=2",
        "iterations=1",
        "num_envs=3",
        "eval_every=1",
        "curve_episodes=2",
        "eval_episodes=2",
        "film=false",
    )
    rows = json.loads((folder / "results.json").read_text())["rows"]
    got = {(row["method"], row["domain"]) for row in rows}
    methods = ("real_only", "sft", "rl_only", "rl_co")
    assert got == {(m, d) for m in methods for d in ("sim", "stand_in")}
    page = (folder / "report.html").read_text()
    for word in (
        *methods,
        "stand_in",
        "no robot moved",
        "lost again",
        "rl_co minus sft",
    ):
        assert word in page
    for name in ("success", "curves", "gradients", "forgetting"):
        assert (folder / "plots" / f"{name}.png").stat().st_size > 1000
    # Self-contained: nothing is fetched from anywhere.
    assert 'src="http' not in page
    assert 'href="http' not in page
