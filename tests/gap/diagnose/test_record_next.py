"""What to record next: safe motions, and the one on which rivals differ most."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from bench_runs import write_run
from hypothesis import given, settings
from hypothesis import strategies as st
from small_problems import ARM

from rlco.errors import OutputExistsError
from rlco.gap import load_model, make_problem, read_log
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.verdict import Gap, NamedEffect, Verdict
from rlco.gap.diagnose.command_file import write_commands
from rlco.gap.diagnose.motions import KINDS, Workspace, workspace_of
from rlco.gap.diagnose.proposals import Motion, Trial, proposed
from rlco.gap.diagnose.record_next import recommend, separations
from rlco.gap.logs.log import Array, Log, Recording
from rlco.gap.search.fit import fit, library_of
from rlco.lerobot_files import read_columns, read_folder
from rlco.physics.effects import AppliedEffect

NOISE = 4e-4
JOINTS = ("shoulder", "elbow")
UNSEEN = "not_identifiable"
DAMPING = AppliedEffect("viscous_damping", "elbow", {"damping": 0.8})
LAG = Candidate("actuator_lag", "elbow")


def slow_commands(seconds: float = 12.0) -> tuple[Array, Array]:
    """Commands of a slow demonstration at 50 Hz: times, goals (T, 2)."""
    time = np.arange(round(50 * seconds)) / 50
    # From rest: a start at full speed would show more than the motion.
    swing = 0.3 * (1.0 - np.cos(np.outer(time, [0.7, 0.8])))
    return time, swing


def recorded(
    effects: tuple[AppliedEffect, ...], time: Array, goals: Array, noise: float = NOISE
) -> ArmRollouts:
    """The arm's problem with a log that was recorded under effects."""
    spec = mujoco.MjSpec.from_string(ARM)
    still = np.zeros_like(goals)
    blank = Recording("a", time, goals.copy(), still, goals)
    problem = ArmRollouts(spec, Log((blank,), JOINTS, JOINTS), np.full(2, NOISE))
    true = problem.traces(Hypothesis(effects), 0)["simulated"]
    rng = np.random.default_rng(0)
    told = true + noise * rng.standard_normal(true.shape)
    told[0] = true[0]
    log = Log((Recording("a", time, told, None, goals),), JOINTS, JOINTS)
    return ArmRollouts(spec, log, np.full(2, NOISE))


def ambiguous(rivals: tuple[Candidate, ...] = (LAG,)) -> Verdict:
    finding = NamedEffect(DAMPING.name, DAMPING.target, {}, rivals)
    gap = Gap("rad", 1e-3, 1e-3, NOISE, NOISE, NOISE)
    effects = Hypothesis((DAMPING,))
    return Verdict(True, "ambiguous", (finding,), gap, {}, (), 1.0, effects, (0,), (0,))


# -- Motions -------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
@settings(max_examples=8, deadline=None)
@given(
    low=st.floats(-2.0, 0.5),
    span=st.floats(0.1, 4.0),
    speed=st.floats(0.1, 4.0),
    at=st.floats(0.0, 1.0),
    rate=st.sampled_from([20.0, 30.0, 50.0, 100.0]),
)
def test_motions_stay_in_range_and_below_speed_and_come_home(
    kind: object, low: float, span: float, speed: float, at: float, rate: float
) -> None:
    workspace = Workspace(
        ("a", "b"),
        np.array([low, -1.0]),
        np.array([low + span, 1.0]),
        np.array([speed, 1.0]),
        np.array([low + at * span, 0.2]),
        rate,
    )
    goals = kind.make(workspace, [0])
    assert goals.shape == (round(20 * rate), 2)
    assert (goals[:, 0] >= low - 1e-9).all()
    assert (goals[:, 0] <= low + span + 1e-9).all()
    assert np.abs(np.diff(goals[:, 0])).max() * rate <= speed * 1.001
    np.testing.assert_allclose(
        goals[[0, -1]], np.tile(workspace.home, (2, 1)), atol=1e-9
    )
    # The other joint was not asked to move.
    assert (goals[:, 1] == 0.2).all()


def test_each_kind_moves_as_it_says() -> None:
    workspace = Workspace(
        ("a",), np.array([-1.0]), np.array([1.0]), np.array([2.0]), np.zeros(1), 50.0
    )
    goals = {kind.name: kind.make(workspace, [0])[:, 0] for kind in KINDS}
    speed = {name: np.abs(np.diff(row)) * 50 for name, row in goals.items()}
    # Slowly: a fifth of the largest speed at most, but for the way home.
    assert np.median(speed["slow_triangle"]) < 0.4
    assert np.mean(speed["holds"] < 1e-9) > 0.3
    assert np.mean(speed["fast_sweep"] > 1.5) > 0.5
    # Several constant speeds, each for a tenth of a second or more.
    speeds, counts = np.unique(speed["cruises"].round(6), return_counts=True)
    assert ((counts >= 5) & (speeds > 0)).sum() >= 4
    # The last seconds of a chirp turn more often than the first.
    turns = np.flatnonzero(np.diff(np.sign(np.diff(goals["chirp"]))))
    assert (turns > 500).sum() > 3 * (turns <= 500).sum()
    jumps = np.flatnonzero(np.diff((speed["big_steps"] > 1.5).astype(int)) == 1)
    assert len(jumps) >= 6


def test_a_robots_room_is_what_its_log_shows() -> None:
    time = np.arange(1000) / 50
    moving = 0.5 + 0.4 * np.sin(2.0 * time)
    positions = np.stack([moving, np.full(1000, 0.2)], axis=1)
    limited = ARM.replace('name="elbow" axis', 'name="elbow" range="-5 15" axis')
    model = mujoco.MjModel.from_xml_string(limited)
    log = Log((Recording("a", time, positions),), JOINTS, JOINTS)
    workspace = workspace_of(model, log)
    np.testing.assert_allclose(workspace.low[0], 0.1, atol=0.01)
    np.testing.assert_allclose(workspace.high[0], 0.9, atol=0.01)
    assert workspace.speed[0] == pytest.approx(0.8, rel=0.02)
    # A joint that did not move: near where it was, within 5 % of its limits of
    # -5 and 15 degrees, at a quarter of the other's speed.
    assert np.degrees(workspace.low[1]) == pytest.approx(-4.0)
    assert np.degrees(workspace.high[1]) == pytest.approx(14.0)
    assert workspace.speed[1] == pytest.approx(0.25 * workspace.speed[0])
    assert workspace.rate == 50.0


def test_a_slide_that_did_not_move_goes_centimetres() -> None:
    xml = ARM.replace('name="elbow" axis', 'name="elbow" type="slide" axis', 1)
    model = mujoco.MjModel.from_xml_string(xml)
    time = np.arange(500) / 50
    swing = np.sin(time)
    # A centimetre is a motion of a slide, as a tenth of a radian is one of a hinge.
    for reach, far in ((0.0, 0.03), (0.01, 0.01)):
        positions = np.column_stack([swing, reach * swing])
        log = Log((Recording("a", time, positions),), JOINTS, JOINTS)
        workspace = workspace_of(model, log)
        assert workspace.high[1] == pytest.approx(far, rel=0.01)
        assert workspace.low[1] == pytest.approx(-far, rel=0.01)
        assert workspace.speed[1] <= 0.026


def test_a_joint_that_was_at_its_limit_stays_where_it_was() -> None:
    limited = ARM.replace('name="elbow"', 'name="elbow" range="-90 90"', 1)
    model = mujoco.MjModel.from_xml_string(limited)
    time = np.arange(500) / 50
    near = 1.54 + 0.03 * np.sin(time)
    log = Log((Recording("a", time, np.column_stack([near, near])),), JOINTS, JOINTS)
    workspace = workspace_of(model, log)
    assert workspace.low[1] == pytest.approx(1.51, abs=1e-3)
    assert workspace.high[1] == pytest.approx(1.57, abs=1e-3)
    for kind in KINDS:
        goals = kind.make(workspace, [1])[:, 1]
        assert goals.min() >= 1.509
        assert goals.max() <= 1.571


# -- Which motion --------------------------------------------------------------


def test_numbers_that_may_follow_tell_nothing_apart() -> None:
    problem = recorded((), *slow_commands())
    other = AppliedEffect("viscous_damping", "elbow", {"damping": 0.82})
    own = Candidate("viscous_damping", "elbow")
    friction = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.2})
    rival = Candidate("coulomb_friction", "elbow")
    apart = separations(problem, (DAMPING,), {own: (other,), rival: (friction,)})
    assert apart[own] < 0.05
    assert apart[rival] > 1.5


A, B, C = (Candidate(name, "elbow") for name in ("backlash", "armature", "payload"))
NAMED = Candidate("viscous_damping", "elbow")


def trial(name: str, *differences: float) -> Trial:
    """Return a motion of 200 rows with differences from A, B and C."""
    apart = dict(zip((A, B, C), differences, strict=True))
    return Trial(Motion(name, name, (), commands=np.zeros((200, 1))), apart, 200)


def test_one_motion_is_enough_where_it_tells_all_apart() -> None:
    # By hand: 200 / 2 * 0.6^2 = 36 nats, beyond the 32 of four deviations.
    both = trial("both", 0.6, 0.7, 0.8)
    (motion,) = proposed(NAMED, (A, B, C), [trial("one", 5.0, 0.1, 9.0), both])
    assert motion.name == "both"
    assert motion.tells_apart == (NAMED, A, B, C)
    assert motion.separation == 0.6
    assert motion.log_bayes == pytest.approx(36.0)


def test_of_motions_that_tell_clearly_that_of_few_joints_is_proposed() -> None:
    for every, few, best in ((9.0, 4.0, "chirp_elbow"), (2.5, 2.0, "chirp_all")):
        trials = [trial("chirp_all", *3 * [every]), trial("chirp_elbow", *3 * [few])]
        (motion,) = proposed(NAMED, (A, B, C), trials)
        assert motion.name == best


def test_two_motions_are_proposed_where_one_cannot() -> None:
    trials = [trial("x", 2.0, 0.1, 0.1), trial("y", 0.1, 2.0, 0.1), trial("z", 0, 0, 2)]
    first, second = proposed(NAMED, (A, B), trials)
    assert (first.name, first.tells_apart) == ("x", (NAMED, A))
    assert (second.name, second.tells_apart) == ("y", (NAMED, B))
    # Two halves of what is needed add up: 100 * 0.45^2 = 20 and 20 nats.
    halves = [trial("x", 0.45, 9.0, 9.0), trial("y", 0.45, 9.0, 8.0)]
    found = proposed(NAMED, (A, B), halves)
    assert {motion.name for motion in found} == {"x", "y"}


def test_where_no_motion_tells_rivals_apart_that_is_said() -> None:
    trials = [trial("x", 2.0, 0.1, 0.3), trial("y", 1.0, 0.2, 0.1)]
    first, nothing = proposed(NAMED, (A, B, C), trials, "Hold a weight.")
    assert (first.name, first.tells_apart) == ("x", (NAMED, A))
    assert nothing.name == "no_motion_viscous_damping"
    assert nothing.tells_apart == (NAMED, B, C)
    assert nothing.how == "No motion of these joints tells them apart. Hold a weight."
    assert nothing.commands is None
    (only,) = proposed(NAMED, (B,), trials)
    assert only.how == "No motion of these joints tells them apart."


@pytest.mark.slow
def test_what_no_motion_can_tell_apart_is_not_proposed() -> None:
    # A rival that is the named effect itself, under another number to start from.
    problem = recorded((DAMPING,), *slow_commands())
    itself = replace(ambiguous().effects[0], rivals=(NAMED,))
    (motion,) = recommend(problem, replace(ambiguous(), effects=(itself,)))
    assert motion.name == "no_motion_viscous_damping"
    assert motion.save(Path("unused"))["commands"] is None


@pytest.mark.slow
def test_the_motion_tells_rivals_apart_that_the_log_does_not() -> None:
    time, goals = slow_commands()
    problem = recorded((DAMPING,), time, goals)
    # On the slow log a lag does as well as the damping, which is the truth.
    assert best_cost(problem, LAG) < 1.1 * best_cost(problem, Candidate(*WHAT))
    (motion,) = recommend(problem, ambiguous())
    assert motion.tells_apart == (Candidate(*WHAT), LAG)
    assert motion.separation is not None
    assert motion.separation > 0.5

    # Recorded, it does what it promised.
    commands = np.asarray(motion.commands)
    times = np.arange(len(commands)) / motion.fps
    after = recorded((DAMPING,), times, commands)
    true, false = best_cost(after, Candidate(*WHAT)), best_cost(after, LAG)
    assert true == pytest.approx(1.0, abs=0.2)
    assert false - true > 0.5 * motion.separation**2


WHAT = ("viscous_damping", "elbow")


def best_cost(problem: ArmRollouts, candidate: Candidate) -> float:
    library = library_of(problem)
    (known,) = library[candidate]
    starts = [
        [AppliedEffect(candidate.name, candidate.target, {known.name: start})]
        for start in known.starts
    ]

    def whiten(lists: list[tuple[AppliedEffect, ...]]) -> Array:
        return problem.residuals([Hypothesis(e) for e in lists]) / NOISE

    return min(one.cost for one in fit(library, starts, whiten))


def test_a_joint_that_never_moved_is_to_be_moved() -> None:
    time, goals = slow_commands()
    goals[:, 1] = 0.0
    problem = recorded((), time, goals, noise=0.0)
    (motion,) = recommend(problem, ambiguous(rivals=()))
    assert motion.name == "fast_sweep_elbow"
    assert np.ptp(np.asarray(motion.commands)[:, 1]) > 0.3
    assert np.ptp(np.asarray(motion.commands)[:, 0]) == 0.0


def test_a_bench_is_to_be_loaded_otherwise(tmp_path: Path) -> None:
    write_run(tmp_path, "run", 200.0, "sines", seconds=5.0)
    loaded = load_model("bam:xl330")
    problem = make_problem(loaded, read_log(tmp_path, loaded))
    loss, limit = (Candidate(name, "servo") for name in ("drive_loss", "torque_limit"))
    finding = NamedEffect(loss.name, loss.target, {}, (limit,))
    (motion,) = recommend(problem, replace(ambiguous(), effects=(finding,)))
    assert motion.tells_apart == (loss, limit)
    assert "heavier and a lighter pendulum" in motion.how
    assert motion.save(tmp_path)["commands"] is None


def test_nothing_is_recommended_where_nothing_is_unclear() -> None:
    assert recommend(recorded((), *slow_commands()), ambiguous(rivals=())) == []


# -- Files ---------------------------------------------------------------------


def saved(folder: Path) -> tuple[Motion, dict[str, object]]:
    rng = np.random.default_rng(1)
    commands = rng.standard_normal((60, 2))
    motion = Motion(
        "chirp_elbow",
        "Swing elbow.",
        (LAG,),
        12.34,
        commands,
        ("a.pos", "b.pos"),
        30,
        1523.4,
    )
    return motion, motion.save(folder)


def test_a_motion_is_saved_as_a_data_set_that_rlco_reads(tmp_path: Path) -> None:
    motion, row = saved(tmp_path)
    assert row == {
        "motion": "chirp_elbow",
        "how": "Swing elbow.",
        "tells_apart": "actuator lag at elbow",
        "noise_floors": 12.3,
        "log_bayes_factor": 1520.0,
        "seconds": 20.0,
        "commands": "record_next/chirp_elbow",
    }
    folder = read_folder(tmp_path / "record_next" / "chirp_elbow")
    assert folder.fps == 30
    assert folder.tasks == {0: "Swing elbow."}
    assert folder.feature("action").names == ("a.pos", "b.pos")
    numbers = read_columns(folder, ["action", "timestamp"])
    np.testing.assert_allclose(numbers["action"], motion.commands, atol=1e-6)
    with pytest.raises(OutputExistsError):
        motion.save(tmp_path)


def test_lerobots_own_reader_gives_the_frames_that_it_would_replay(
    tmp_path: Path,
) -> None:
    from lerobot import datasets  # takes seconds

    motion, row = saved(tmp_path)
    # As lerobot-replay opens it, and reads each row's action.
    dataset = datasets.LeRobotDataset(
        "local/chirp", root=tmp_path / str(row["commands"]), episodes=[0]
    )
    assert dataset.fps == 30
    assert dataset.num_frames == 60
    names = dataset.features["action"]["names"]
    assert names == ["a.pos", "b.pos"]
    actions = dataset.hf_dataset.select_columns("action")
    got = np.stack([np.asarray(actions[i]["action"]) for i in range(60)])
    np.testing.assert_allclose(got, motion.commands, atol=1e-6)
    assert dataset[3]["task"] == "Swing elbow."


def test_commands_are_not_written_over(tmp_path: Path) -> None:
    folder = tmp_path / "commands"
    write_commands(folder, np.zeros((5, 1)), names=["j"], fps=10, task="rest")
    with pytest.raises(OutputExistsError):
        write_commands(folder, np.zeros((5, 1)), names=["j"], fps=10, task="rest")


def test_commands_are_those_of_the_actuators() -> None:
    """Through the gear of a servo; what is no joint's servo is sent as in the log."""
    geared = ARM.replace('joint="elbow" kp="40"', 'joint="elbow" gear="-2" kp="10"')
    feed = '<actuator><velocity name="feed" joint="elbow" kv="1e-3"/>'
    time, goals = slow_commands()
    sent = np.column_stack([np.full(len(time), 7.0), goals[:, 0], -2.0 * goals[:, 1]])
    found = []
    for xml, names, commands in (
        (ARM, JOINTS, goals),
        (geared.replace("<actuator>", feed), ("feed", *JOINTS), sent),
    ):
        part = Recording("a", time, goals, np.zeros_like(goals), commands)
        spec = mujoco.MjSpec.from_string(xml)
        problem = ArmRollouts(spec, Log((part,), JOINTS, names), np.full(2, NOISE))
        (motion,) = recommend(problem, replace(ambiguous(()), verdict=UNSEEN))
        assert motion.commands is not None
        found.append(motion.commands)
    plain, other = found
    assert np.ptp(plain, axis=0).min() > 0.3
    np.testing.assert_allclose(other[:, 1:], plain * [1.0, -2.0])
    assert (other[:, 0] == 7.0).all()


def test_no_commands_are_proposed_for_motors() -> None:
    xml = ARM.replace('<position name="elbow" joint="elbow" kp="40" kv="2"', "<motor")
    xml = xml.replace("<motor", '<motor name="elbow" joint="elbow"')
    time, goals = slow_commands()
    part = Recording("a", time, goals, np.zeros_like(goals), goals)
    spec = mujoco.MjSpec.from_string(xml)
    problem = ArmRollouts(spec, Log((part,), JOINTS, JOINTS), np.full(2, NOISE))
    (motion,) = recommend(problem, replace(ambiguous(()), verdict=UNSEEN))
    # Goals of positions would be torques to it.
    assert motion.commands is None
    assert motion.how == "Move shoulder, elbow more."


def test_commands_stay_in_their_folder_whatever_a_joint_is_called(
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    goals = np.zeros((40, 1))
    rows = [
        Motion(name, "", (), commands=goals, names=("a",), fps=20).save(out)
        for name in ("sweep_/../../../far", "sweep__.._.._.._far", "sweep_" + 200 * "ö")
    ]
    folders = [out / str(row["commands"]) for row in rows]
    assert [one.parent for one in folders] == [out / "record_next"] * 3
    assert all((one / "meta" / "info.json").is_file() for one in folders)
    assert [one.name for one in tmp_path.iterdir()] == ["out"]
