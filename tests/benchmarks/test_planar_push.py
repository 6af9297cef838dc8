"""The planar task: its geometry, its expert, its gaps, and a run of both stages."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import planar_push
import pytest
import torch
from planar.demos import REST, play_expert, record
from planar.env import CHUNK, STAYING, PlanarEnv
from planar.evaluation import evaluation_envs
from planar.gaps import GAPS, ROTATION, SIM, Gap, named_gap
from planar.world import RADIUS, STEP, SUBSTEPS, Start, World

from rlco import keys
from rlco.errors import UnknownNameError
from rlco.run import run_recipe
from rlco.runs.compare.code_version import ROOT, sources

FAR = np.array([[0.0, 5.0], [0.0, -5.0]])  # two discs that nothing touches
SCRIPT = ROOT / "benchmarks" / "planar_push.py"


def world(gap: Gap, disc: tuple[float, float], mark: tuple[float, float]) -> World:
    """Return one plane with the tool at the origin and the first disc to push."""
    made = World(1, gap)
    discs, marks = np.vstack([disc, FAR]), np.vstack([mark, FAR])
    made.reset([0], [Start(np.zeros(2), discs, marks, 0)])
    return made


def step(made: World, x: float, y: float = 0.0) -> None:
    made.step(np.array([[x, y]]), np.array([True]))


# -- Geometry ----------------------------------------------------------------------


def test_a_push_stops_short_of_a_disc_that_is_out_of_reach() -> None:
    made = world(SIM, (0.10, 0.0), (1.0, 0.0))
    step(made, 1.0)  # to 0.05; the disc begins at 0.10 - 0.045
    np.testing.assert_allclose(made.tool, [[STEP, 0.0]])
    np.testing.assert_array_equal(made.discs[0, 0], [0.10, 0.0])


def test_a_push_leaves_the_disc_its_radius_ahead_of_the_tool() -> None:
    made = world(SIM, (0.07, 0.0), (1.0, 0.0))
    step(made, 1.0)
    # Quarters of 0.0125. After the second the tool stands at 0.025 and touches, from
    # 0.070 - 0.025 = 0.045 on; in the third and fourth the disc follows as a whole.
    np.testing.assert_allclose(made.discs[0, 0], [0.07 + 2 * 0.0125, 0.0], atol=1e-9)
    np.testing.assert_array_equal(made.discs[0, 1:], FAR)


def test_a_disc_slips_sideways_along_the_tool() -> None:
    # The disc lies just within reach ahead of the tool, which moves at 45 degrees.
    near = RADIUS - 1e-6
    gripped = world(SIM, (near, 0.0), (1.0, 0.0))
    slipping = world(replace(SIM, slip=0.4), (near, 0.0), (1.0, 0.0))
    quarter = STEP / SUBSTEPS
    motion = np.array([[quarter / 5, quarter / 5]])
    for made in (gripped, slipping):
        made._push(motion)
    np.testing.assert_allclose(gripped.discs[0, 0], [near, 0] + motion[0], atol=2e-6)
    # 0.6 of the motion, then along the line from the tool to a distance of the radius.
    moved = np.array([near, 0.0]) + 0.6 * motion[0]
    line = (moved - motion[0]) / np.linalg.norm(moved - motion[0])
    np.testing.assert_allclose(slipping.discs[0, 0], motion[0] + RADIUS * line)


def test_a_tool_that_moves_away_takes_no_disc_along() -> None:
    made = world(SIM, (RADIUS - 1e-9, 0.0), (1.0, 0.0))
    step(made, -1.0)
    np.testing.assert_allclose(made.discs[0, 0], [RADIUS, 0.0], atol=1e-8)


def test_a_task_is_solved_within_three_centimetres_and_staying_is_paid() -> None:
    assert world(SIM, (0.5, 0.0), (0.529, 0.0)).solved().tolist() == [True]
    assert world(SIM, (0.5, 0.0), (0.531, 0.0)).solved().tolist() == [False]
    env = PlanarEnv(SIM, num_envs=1, seed=0, horizon=6)
    data = env.reset()
    env.world = world(SIM, (0.5, 0.0), (0.5, 0.0))
    rewards = []
    for _ in range(2):
        data = env.step(data.set(keys.ACTION, torch.zeros(1, CHUNK, 2)))["next"]
        rewards.append(float(data[keys.REWARD]))
    # Four control steps, then the two that are left.
    np.testing.assert_allclose(rewards, [4 * STAYING, 2 * STAYING], atol=1e-7)


def test_the_potential_grows_by_ten_a_metre_of_the_disc() -> None:
    # The tool stands where it pushes from, 6 cm behind the disc.
    before = world(SIM, (0.06, 0.0), (0.30, 0.0)).potential()
    after = world(SIM, (0.06, 0.0), (0.25, 0.0)).potential()
    np.testing.assert_allclose(after - before, 10 * 0.05)


# -- Gaps --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gap", "x", "y"),
    [
        ("yaw0", 0.2, 0.1),
        ("yaw90", -0.1, 0.2),
        ("yaw180", -0.2, -0.1),
        ("yaw45", 0.1 / np.sqrt(2), 0.3 / np.sqrt(2)),
    ],
)
def test_a_turned_camera_reports_turned_positions(gap: str, x: float, y: float) -> None:
    points = np.zeros((1, 6, 2))
    points[0, 4] = 0.2, 0.1  # the second mark
    reported = named_gap(gap).report(points, np.zeros_like(points)).reshape(6, 2)
    np.testing.assert_allclose(reported[4], [x + 0.025, y - 0.015], atol=1e-12)
    np.testing.assert_allclose(reported[0], [0.025, -0.015], atol=1e-12)


def test_noise_is_added_in_metres() -> None:
    points = np.zeros((1, 6, 2))
    noise = np.ones_like(points)
    np.testing.assert_allclose(SIM.report(points, noise), np.full((1, 12), 0.001))


def test_the_rotation_keeps_distances_and_mixes_all_values() -> None:
    np.testing.assert_allclose(ROTATION @ ROTATION.T, np.eye(12), atol=1e-12)
    assert np.linalg.det(ROTATION) == pytest.approx(1.0)
    assert np.abs(ROTATION).max() < 0.9
    points = np.random.default_rng(0).normal(size=(1, 6, 2))
    mixed = named_gap("rotation").report(points, np.zeros_like(points))
    plain = named_gap("yaw0").report(points, np.zeros_like(points))
    np.testing.assert_allclose(mixed, plain @ ROTATION)


def test_a_delay_is_one_control_step_and_a_gain_scales_the_motion() -> None:
    made = world(GAPS["delay_gain"], (1.0, 0.0), (2.0, 0.0))
    positions = []
    for command in (1.0, 0.0, 0.5):
        step(made, command)
        positions.append(made.tool[0, 0])
    np.testing.assert_allclose(positions, np.cumsum([0.0, 0.6 * STEP, 0.0]))
    # A new episode forgets the command that was on its way.
    made.reset([0], [Start(np.zeros(2), np.zeros((3, 2)) + 5, np.ones((3, 2)), 0)])
    step(made, 0.0)
    assert made.tool[0, 0] == 0.0


def test_an_ended_episode_stands_still() -> None:
    made = world(GAPS["delay_gain"], (1.0, 0.0), (2.0, 0.0))
    step(made, 1.0)
    made.step(np.array([[1.0, 0.0]]), np.array([False]))
    assert made.tool[0, 0] == 0.0
    step(made, 0.0)  # the command of the first step is still the next one
    assert made.tool[0, 0] == pytest.approx(0.6 * STEP)


def test_an_unknown_gap_is_named() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'yaw45'"):
        named_gap("yaw44")


# -- Expert and demonstrations -----------------------------------------------------


@pytest.mark.parametrize("gap", ["sim", *GAPS])
def test_the_expert_solves_95_of_100(gap: str) -> None:
    played = play_expert(SIM if gap == "sim" else GAPS[gap], 200, seed=3)
    assert played.solved[-1].mean() >= 0.95


def test_demonstrations_are_solved_balanced_and_end_after_a_rest() -> None:
    demos = record(SIM, 7, seed=1)
    frames = demos.frames()
    starts = frames["frame"] == 0
    assert frames[keys.INSTRUCTION_ID][starts].bincount().tolist() == [3, 2, 2]
    # The chunk is this frame's action and those after it; past the end the last one.
    length = demos.meta.episode_lengths[0]
    assert frames[keys.IS_PAD][length - 2].tolist() == [False, False, True, True]
    torch.testing.assert_close(frames[keys.CHUNK][0], frames[keys.ACTION][:CHUNK])
    last = frames[keys.ACTION][length - 1]
    torch.testing.assert_close(frames[keys.CHUNK][length - 2][1:], last.expand(3, 2))
    # Played again, an episode is solved REST steps before its end and not earlier.
    played = play_expert(SIM, 30, seed=1)
    first = int(np.flatnonzero(played.solved[-1])[0])
    unsolved = int(np.flatnonzero(~played.solved[:, first])[-1])
    assert length == unsolved + 2 + REST


def test_the_same_seed_demonstrates_the_same() -> None:
    one, other = (record(GAPS["yaw45"], 6, seed=4).frames() for _ in range(2))
    torch.testing.assert_close(one[keys.CHUNK], other[keys.CHUNK], rtol=0, atol=0)
    more = record(GAPS["yaw45"], 6, seed=5).frames()
    assert len(more) != len(one) or not torch.equal(more[keys.STATE], one[keys.STATE])


# -- The environment ---------------------------------------------------------------


def test_both_domains_start_alike_and_report_otherwise() -> None:
    envs = evaluation_envs("yaw90", 4)
    sim, real = (env.reset() for env in envs.values())
    torch.testing.assert_close(sim[keys.STATE], real[keys.STATE])
    torch.testing.assert_close(sim[keys.INSTRUCTION_ID], real[keys.INSTRUCTION_ID])
    worlds = [env.world for env in envs.values()]
    np.testing.assert_array_equal(worlds[0].discs, worlds[1].discs)
    # Turned by 90 degrees and shifted: x there is -y here, up to the noise.
    there = real[keys.ENVIRONMENT_STATE][:, 0]
    here = sim[keys.ENVIRONMENT_STATE][:, 1]
    torch.testing.assert_close(there - 0.025, -here, rtol=0, atol=0.02)


def test_episodes_do_not_depend_on_the_batch_size() -> None:
    small, large = (PlanarEnv(SIM, num_envs=n, seed=9) for n in (2, 4))
    small.start_at(1)  # its episodes 2 and 3
    seen, all_of_them = small.reset(), large.reset()
    torch.testing.assert_close(
        seen[keys.ENVIRONMENT_STATE], all_of_them[keys.ENVIRONMENT_STATE][2:]
    )


def test_the_environment_moves_as_the_expert_does_alone() -> None:
    # The chunked environment and the plain loop of demonstrations share one physics.
    env = PlanarEnv(SIM, num_envs=5, seed=2, horizon=10)
    data = env.reset()
    single = World(5, SIM)
    for name in ("tool", "discs", "marks", "target"):
        setattr(single, name, getattr(env.world, name).copy())
    rng = np.random.default_rng(0)
    for decision in range(3):
        actions = rng.uniform(-1.0, 1.0, (5, CHUNK, 2)).astype(np.float32)
        data = env.step(data.set(keys.ACTION, torch.from_numpy(actions)))["next"]
        for index in range(CHUNK if decision < 2 else 2):  # ten steps and no more
            single.step(actions[:, index].astype(np.float64), np.ones(5, dtype=bool))
    np.testing.assert_allclose(env.world.tool, single.tool)
    np.testing.assert_allclose(env.world.discs, single.discs)
    assert bool(data[keys.DONE].all())


# -- Runs --------------------------------------------------------------------------

TINY = ("gap=yaw45", "seed=100", "sim_demos=6", "real_demos=3", "heldout_demos=3")


def start(*arguments: str) -> None:
    run_recipe(planar_push.main, planar_push.Config, arguments)


@pytest.fixture(scope="module")
def stage_one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("planar") / "one"
    start(*TINY, "updates=20", "eval_episodes=6", f"out={out}")
    return out


def stage_two(one: Path, out: Path, *more: str) -> None:
    policy = f"policy={one / 'stages' / 'sft' / 'policy'}"
    sizes = ("num_envs=8", "eval_every=2", "eval_episodes=6")
    start("stage=two", *TINY, *sizes, policy, f"out={out}", *more)


@pytest.mark.slow
def test_stage_one_reports_three_methods_in_two_domains(stage_one: Path) -> None:
    rows = json.loads((stage_one / "results.json").read_text())["rows"]
    assert [(row["method"], row["domain"]) for row in rows] == [
        (method, domain)
        for method in ("real_only", "sim_only", "sft")
        for domain in ("sim", "stand_in")
    ]
    for row in rows:
        assert len(row["outcomes"]) == len(row["ever"]) == row["episodes"] == 6
        assert sum(row["outcomes"]) == row["successes"]
        # What is solved at the end was solved at some time.
        assert all(np.array(row["ever"]) >= np.array(row["outcomes"]))


@pytest.mark.slow
@pytest.mark.thorough
def test_the_same_seed_gives_the_same_and_a_resumed_run_too(
    stage_one: Path, tmp_path: Path
) -> None:
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    stage_two(stage_one, whole, "iterations=4")
    stage_two(stage_one, halves, "iterations=2")
    start("resume=" + str(halves), "iterations=4")
    rows = [(run / "metrics.csv").read_bytes() for run in (whole, halves)]
    assert rows[0] == rows[1]
    results = [
        json.loads((run / "results.json").read_text())["rows"]
        for run in (whole, halves)
    ]
    assert results[0] == results[1]
    assert {row["method"] for row in results[0]} == {"rl_co"}


def test_without_an_anchor_no_demonstration_pulls(
    stage_one: Path, tmp_path: Path
) -> None:
    stage_two(stage_one, tmp_path / "rl", "iterations=1", "real_coeff=0")
    rows = json.loads((tmp_path / "rl" / "results.json").read_text())["rows"]
    assert {row["method"] for row in rows} == {"rl_only"}
    header = (tmp_path / "rl" / "metrics.csv").read_text().splitlines()[0]
    assert "loss_bc_real" not in header
    assert "ever_stand_in" in header


def test_a_stage_two_without_a_policy_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        start("stage=two", f"out={tmp_path / 'out'}")
    assert "stage=two starts from policy=FOLDER" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.thorough
def test_the_version_of_its_code_covers_all_that_it_loads(
    stage_one: Path, tmp_path: Path
) -> None:
    code = (
        "import json, sys, planar_push\n"
        "from rlco.run import run_recipe\n"
        "run_recipe(planar_push.main, planar_push.Config)\n"
        "print(json.dumps([m.__file__ for n, m in sys.modules.items() if"
        " n.partition('.')[0] in ('rlco', 'planar', 'planar_push')]))"
    )
    given = [
        *("stage=two", *TINY, "iterations=1", "num_envs=4", "eval_episodes=2"),
        *(f"policy={stage_one / 'stages/sft/policy'}", f"out={tmp_path / 'out'}"),
    ]
    done = subprocess.run(
        [sys.executable, "-c", code, *given],
        capture_output=True,
        text=True,
        check=True,
        cwd=SCRIPT.parent,  # where Python looks for planar_push
    )
    loaded = {Path(path).resolve() for path in json.loads(done.stdout.splitlines()[-1])}
    assert SCRIPT.resolve() in loaded
    assert loaded <= set(sources(SCRIPT).values())
