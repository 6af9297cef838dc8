"""Which comparison is shown, what torques say beside it, and what is left out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hidden_arms import TWO_LINKS, commands

from rlco.errors import DataError, UnknownNameError
from rlco.gap import run_gap
from rlco.gap.compare.comparisons import chosen, first_lines, possible
from rlco.gap.compare.torque.held_commands import effort_jumps
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.logs.log import Log, Recording
from rlco.physics.effects import EFFECTS

STEP, EVERY = 0.004, 2  # commands are held for 8 ms
NAMES = ("shoulder", "elbow")
ONE_STEP = TWO_LINKS.replace('kp="40"', 'kp="400"').replace('kp="20"', 'kp="200"')
LIBRARY = {"viscous_damping", "command_delay"}


def recorded(
    effort: str, *, damping: float = 0.0, late: int = 0, episodes: int = 6
) -> Log:
    """Record the arm, its effort read in one of three ways.

    Args:
        effort: ``before`` each new command, the ``mean`` over the time around it, or
            ``smooth``: commands are not held, but rise from one to the next.
        damping: What the shoulder has more of than the model.
        late: Rows by which commands come late.
        episodes: Recordings.
    """
    model = mujoco.MjModel.from_xml_string(ONE_STEP)
    model.dof_damping[0] += damping
    parts = []
    for episode in range(episodes):
        slow = commands(episode, 2.4)
        at = np.arange(len(slow)) * 0.02
        time = np.arange(0.0, at[-1], STEP * EVERY)
        # Without steps: only how a command is held makes a jump.
        width = np.hanning(60) / np.hanning(60).sum()
        sent = np.stack([np.interp(time, at, one) for one in slow.T], axis=1)
        sent = np.stack([np.convolve(one, width, "same") for one in sent.T], axis=1)
        data = mujoco.MjData(model)
        rows: list[list[np.ndarray]] = []
        for row in range(len(time)):
            rows.append([data.qpos.copy(), data.qvel.copy()])
            goal = sent[max(row - late, 0)]
            after = sent[max(min(row + 1, len(sent) - 1) - late, 0)]
            forces = []
            for step in range(EVERY):
                part = step / EVERY if effort == "smooth" else 0.0
                data.ctrl[:] = goal + part * (after - goal)
                mujoco.mj_step(model, data)
                forces.append(data.qfrc_actuator.copy())
            rows[-1] += forces
        place, speed, first, last = (np.array([r[i] for r in rows]) for i in range(4))
        mean = (first + last) / 2
        read = {
            "before": np.vstack([last[:1], last[:-1]]),
            "mean": (mean + np.vstack([mean[:1], mean[:-1]])) / 2,
            "smooth": first,
        }[effort]
        noise = np.random.default_rng(episode)
        place = place + noise.normal(0, 2e-5, place.shape)
        read = read + noise.normal(0, 5e-3, read.shape)
        parts.append(Recording(f"run {episode}", time, place, speed, sent, read))
    return Log(tuple(parts), NAMES, NAMES)


def write(folder: Path, log: Log, *, sent: bool = True) -> tuple[Path, Path]:
    """Write a model and its log as PlotJuggler does; return where they lie."""
    (folder / "logs").mkdir(parents=True)
    (folder / "arm.xml").write_text(ONE_STEP)
    for part in log.recordings:
        columns = {"__time": part.time}
        for i, name in enumerate(NAMES):
            topic = f"/joint_states/{name}"
            columns |= {f"{topic}/position": np.asarray(part.position)[:, i]}
            columns |= {f"{topic}/velocity": np.asarray(part.velocity)[:, i]}
            columns |= {f"{topic}/effort": np.asarray(part.torque)[:, i]}
            if sent:
                goal = np.asarray(part.command)[:, i]
                columns |= {f"/forward_position_controller/commands/data[{i}]": goal}
        columns["/tool/temperature"] = part.time
        file = folder / "logs" / f"{part.name}.csv"
        rows = np.column_stack(list(columns.values()))
        header = ",".join(columns)
        np.savetxt(file, rows, delimiter=",", header=header, comments="", fmt="%.8f")
    return folder / "arm.xml", folder / "logs"


def problem(log: Log) -> TorqueLog:
    return TorqueLog(mujoco.MjSpec.from_string(ONE_STEP), log)


def test_effort_before_each_command_lies_beside_its_mean() -> None:
    log, means = recorded("before", episodes=3), recorded("mean", episodes=3)
    jumps = effort_jumps(problem(log))
    assert jumps is not None
    assert jumps.joints == NAMES
    assert jumps.period == pytest.approx(0.008)
    beside = [
        np.asarray(one.torque)[25:-25] - np.asarray(other.torque)[25:-25]
        for one, other in zip(log.recordings, means.recordings, strict=True)
    ]
    truth = np.sqrt(np.mean(np.concatenate(beside) ** 2, axis=0))
    np.testing.assert_allclose(jumps.beside, truth, rtol=0.1)


@pytest.mark.parametrize("effort", ["mean", "smooth"])
def test_effort_without_jumps_is_not_suspected(effort: str) -> None:
    assert effort_jumps(problem(recorded(effort, episodes=3))) is None


@pytest.mark.parametrize("effort", ["before", "smooth"])
def test_a_missing_damping_and_a_delay_hide_no_jumps_and_make_none(effort: str) -> None:
    log = recorded(effort, damping=3.0, late=3, episodes=3)
    assert (effort_jumps(problem(log)) is None) == (effort == "smooth")


def test_positions_come_first_and_torques_beside_them() -> None:
    log = recorded("mean", episodes=1)
    (part,) = log.recordings
    without = replace(log, recordings=(replace(part, command=None),), actuators=())
    bare = replace(without, recordings=(replace(part, command=None, torque=None),))
    assert possible(log) == ("positions", "torques")
    assert chosen(log, None) == chosen(log, "both") == ("positions", "torques")
    assert chosen(log, "positions") == ("positions", None)
    assert chosen(log, "torques") == ("torques", None)
    assert chosen(without, None) == ("torques", None)
    assert chosen(bare, None) == (None, None)
    with pytest.raises(DataError, match=r"compare=both needs .* commands .*=torques"):
        chosen(without, "both")
    with pytest.raises(UnknownNameError, match="did you mean 'torques'"):
        chosen(log, "torque")


def test_the_first_lines_say_what_is_shown_left_out_and_lacking() -> None:
    log = recorded("mean", episodes=1)
    part = replace(log.recordings[0], torque=None)
    log = replace(log, recordings=(part,), unused=("actual_current_0", "volts"))
    lines = " ".join(first_lines(log, "positions", None, False))
    assert "Compared: joint positions, simulated under the recorded commands." in lines
    assert "Left out: 2 columns, actual_current_0, volts." in lines
    assert "To compare torques as well: give joint torques [N m]" in lines
    assert "actual_current_0 are currents: multiply each by torque constant" in lines
    assert "scale=actual_current_0:NUMBER,..., and call them torques" in lines


@pytest.fixture(scope="module")
def jumping(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("jumping")
    return write(folder, recorded("before", damping=3.0, late=3))


@pytest.mark.thorough
def test_more_channels_do_not_make_the_answer_worse(
    jumping: tuple[Path, Path], tmp_path: Path
) -> None:
    finding = run_gap(*jumping, threads=1, exclude=set(EFFECTS) - LIBRARY)
    numbers = {e.name: next(iter(e.parameters.values())).value for e in finding.effects}
    assert numbers == {
        "command_delay": pytest.approx(3 * STEP * EVERY, rel=0.02),
        "viscous_damping": pytest.approx(3.0, rel=0.02),
    }
    words = " ".join(finding.summary())
    assert "damping 0.200 → 3.20 N m s/rad" in words
    assert "Measured torques cannot check this. Effort of elbow looks" in words
    told = " ".join(finding.compared)
    assert "Left out: 1 column, /tool/temperature." in told
    page = finding.write(tmp_path / "report")
    content = json.loads((page.parent / "report.json").read_text())
    shown, check = content["comparisons"]
    assert (shown["compared"], shown["searched"]) == ("positions", True)
    assert shown["effects"] == content["effects"]
    assert (shown["verdict"], shown["gap"]) == (content["verdict"], content["gap"])
    assert (check["compared"], check["searched"]) == ("torques", False)
    assert (check["verdict"], check["doubtful"]) == (None, True)
    assert content["doubtful"] is None
    text = page.read_text("utf-8")
    assert "What to do now" in text
    assert "Compared: joint positions" in text


@pytest.mark.slow
@pytest.mark.thorough
def test_torques_confirm_what_positions_named(tmp_path: Path) -> None:
    case = write(tmp_path / "case", recorded("mean", damping=3.0, late=3))
    finding = run_gap(*case, threads=1, exclude=set(EFFECTS) - LIBRARY)
    _, check = finding.comparisons
    assert check.gap is not None
    assert not check.warned
    # A delay changes the motion, and not what that motion takes.
    assert check.gap.after_heldout < 0.2 * check.gap.before_heldout
    words = " ".join(finding.summary())
    assert "A check by torques: with viscous damping at shoulder their disag" in words


@pytest.mark.slow
def test_a_name_by_torques_that_jump_is_given_with_a_warning(
    jumping: tuple[Path, Path], tmp_path: Path
) -> None:
    finding = run_gap(
        *jumping, threads=1, exclude=set(EFFECTS) - LIBRARY, compare="torques"
    )
    (shown,) = finding.comparisons
    assert (shown.compared, shown.warned) == ("torques", True)
    first, *rest = finding.summary()
    assert first.startswith("Do not act on what follows: Effort of elbow looks")
    assert not any("take no name from these torques" in line for line in rest)
    # A light joint's effort seems to run against the model's then, which it does not.
    assert not any("sign was changed" in note for note in finding.notes)
    page = finding.write(tmp_path / "report").read_text("utf-8")
    # Nobody trains in what such torques name.
    assert {one.name for one in (tmp_path / "report").iterdir()} <= {
        "report.html",
        "report.json",
    }
    content = json.loads((tmp_path / "report" / "report.json").read_text())
    assert content["doubtful"] in first
    box = page.partition("What to do now")[2].partition("</aside>")[0]
    assert "do not act on this: Effort of elbow looks" in box


@pytest.mark.thorough
def test_both_are_searched_where_that_is_asked_for(tmp_path: Path) -> None:
    case = write(tmp_path / "case", recorded("mean", damping=3.0))
    finding = run_gap(*case, threads=1, exclude=set(EFFECTS) - LIBRARY, compare="both")
    names = []
    for one in finding.comparisons:
        assert one.verdict is not None
        names.append([(e.name, e.target) for e in one.verdict.effects])
    assert names == [[("viscous_damping", "shoulder")]] * 2


def test_torques_of_another_unit_are_no_reason_to_refuse_positions(
    tmp_path: Path,
) -> None:
    log = recorded("mean", damping=3.0)
    parts = [replace(r, torque=np.asarray(r.torque) * 37.0) for r in log.recordings]
    case = write(tmp_path / "case", replace(log, recordings=tuple(parts)))
    finding = run_gap(*case, threads=1, exclude=set(EFFECTS) - LIBRARY)
    assert [effect.name for effect in finding.effects] == ["viscous_damping"]
    assert any(
        "was not possible: the log's torques are" in s for s in finding.summary()
    )
    with pytest.raises(DataError, match="give them in N m"):
        run_gap(*case, threads=1, compare="torques")
