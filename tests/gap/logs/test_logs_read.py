"""Each format gives the same log, in the model's order."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from log_cases import (
    JOINTS,
    arm,
    arm_columns,
    motion,
    write_arm,
    write_csv,
    write_lerobot,
)

from rlco.errors import DataError
from rlco.gap.logs import read_log
from rlco.gap.logs.log import Log

TIME, POSITION, COMMAND = motion()


def check_motion(log: Log, tolerance: float = 1e-6) -> None:
    """The log is the motion, in the order of the model."""
    assert log.joints == JOINTS
    part = log.recordings[0]
    np.testing.assert_allclose(part.time, TIME, atol=tolerance)
    np.testing.assert_allclose(part.position, POSITION, atol=tolerance)
    if part.command is not None:
        assert log.actuators == ("m1", "m2", "m3")
        np.testing.assert_allclose(part.command, COMMAND, atol=tolerance)


def test_csv_in_any_order_of_columns(tmp_path: Path) -> None:
    columns = arm_columns(TIME, POSITION, COMMAND)
    shuffled = {key: columns[key] for key in sorted(columns, reverse=True)}
    log = read_log(write_csv(tmp_path / "a.csv", shuffled), arm(tmp_path))
    check_motion(log)
    assert log.recordings[0].command is not None
    assert log.notes == ()


def test_csv_of_counted_columns_keeps_the_rest_aside(tmp_path: Path) -> None:
    columns = {"t_ms": 1e3 * TIME + 5e6}
    columns |= {f"q{i + 1}": POSITION[:, i] for i in range(3)}
    columns |= {f"tau[{i}]": 2 * POSITION[:, i] for i in range(3)}
    columns |= {"volts": TIME}
    log = read_log(write_csv(tmp_path / "a.csv", columns), arm(tmp_path))
    check_motion(log)
    part = log.recordings[0]
    np.testing.assert_allclose(part.torque, 2 * POSITION, atol=1e-6)
    np.testing.assert_allclose(part.extra["volts"], TIME)
    assert part.command is None
    assert "counts its joints, read in order: shoulder, elbow, wrist" in log.notes[0]


def test_csv_as_numpy_and_as_spreadsheets_write_it(tmp_path: Path) -> None:
    model = arm(tmp_path)
    columns = arm_columns(TIME, POSITION)
    header, rows = ",".join(columns), np.column_stack(list(columns.values()))
    np.savetxt(tmp_path / "numpy.csv", rows, delimiter=",", header=header)
    check_motion(read_log(tmp_path / "numpy.csv", model))
    lines = [";".join(f"{x:.9f}" for x in row).replace(".", ",") for row in rows]
    text = "\ufeff" + "\n".join(["# made by hand", header.replace(",", ";"), *lines])
    (tmp_path / "sheet.csv").write_text(text)
    check_motion(read_log(tmp_path / "sheet.csv", model))


def test_an_episode_column_tells_recordings_apart(tmp_path: Path) -> None:
    episode = np.repeat([3.0, 4.0], 150)
    time = np.tile(TIME[:150], 2)
    file = write_arm(tmp_path / "a.csv", time=time, episode=episode)
    log = read_log(file, arm(tmp_path))
    assert [part.name for part in log.recordings] == ["a episode 3", "a episode 4"]
    np.testing.assert_allclose(log.recordings[1].position, POSITION[150:], atol=1e-6)


def test_a_folder_of_files_is_that_many_recordings(tmp_path: Path) -> None:
    model = arm(tmp_path)
    (tmp_path / "logs").mkdir()
    for name in ("b", "a"):
        write_arm(tmp_path / "logs" / f"{name}.csv")
    log = read_log(tmp_path / "logs", model)
    assert [part.name for part in log.recordings] == ["a", "b"]
    write_arm(tmp_path / "logs" / "c.csv", q9=TIME)
    with pytest.raises(DataError, match=r"'a' and 'c' differ in their columns .*9"):
        read_log(tmp_path / "logs", model)


def test_npz_of_channels(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "a.npz",
        time=TIME,
        dof_pos=POSITION[:, ::-1],
        des_dof_pos=COMMAND[:, ::-1],
        joint_names=np.array(JOINTS[::-1]),
        payload=np.array(0.3),
    )
    log = read_log(tmp_path / "a.npz", arm(tmp_path))
    check_motion(log)
    assert log.recordings[0].facts == {"payload": 0.3}


def test_npz_of_a_free_body_in_units_of_its_own(tmp_path: Path) -> None:
    file = tmp_path / "cube.xml"
    file.write_text(
        "<mujoco><worldbody><body name='cube'><freejoint/><geom size='.1'/></body>"
        "</worldbody></mujoco>"
    )
    angle = np.repeat(np.arange(60) * 0.1, 2)[::2]
    data = np.zeros((60, 13))
    # One unit is a tenth of a metre; the quaternion changes its sign on the way.
    data[:, 0], data[:, 7] = 3.0, 5.0
    data[:, 3], data[:, 6] = np.cos(angle / 2), np.sin(angle / 2)
    data[30:, 3:7] *= -1
    np.savez(
        tmp_path / "tosses.npz",
        data=data,
        length=np.array([35, 25]),
        toss=np.array([7, 9]),
    )
    (tmp_path / "setup.json").write_text(json.dumps({"dt": 0.1, "g": 98.1}))
    from rlco.gap.model import load_model

    log = read_log(tmp_path / "tosses.npz", load_model(file))
    first, second = log.recordings
    assert log.body == "cube"
    assert (first.rows, second.rows) == (35, 25)
    assert (first.facts["toss"], second.facts["toss"]) == (7.0, 9.0)
    np.testing.assert_allclose(first.time, np.arange(35) * 0.1)
    np.testing.assert_allclose(first.pose[:, 0], 0.3)
    np.testing.assert_allclose(first.extra["vx"], 0.5)
    np.testing.assert_allclose(first.pose[:, 3], np.cos(angle[:35] / 2))
    assert any("units of 0.1 m" in note for note in log.notes)


def test_a_pose_is_that_of_the_body_it_names(tmp_path: Path) -> None:
    body = "<body name='{}'><freejoint/><geom size='.1'/></body>"
    bodies = body.format("cup") + body.format("lid")
    model = arm(tmp_path, f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    still = [np.full(300, x) for x in (0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0)]
    axes = ("x", "y", "z", "qw", "qx", "qy", "qz")
    for name in ("lid", "cup"):
        columns = dict(zip((f"{name}.{axis}" for axis in axes), still, strict=True))
        log = read_log(write_csv(tmp_path / "a.csv", {"time": TIME, **columns}), model)
        assert log.body == name
        np.testing.assert_allclose(
            log.recordings[0].pose[0], [0.1, 0.2, 0.3, 1, 0, 0, 0]
        )
    plain = dict(zip(axes, still, strict=True))
    file = write_csv(tmp_path / "a.csv", {"time": TIME, **plain})
    with pytest.raises(DataError, match=r"has 2 \(cup, lid\)"):
        read_log(file, model)


def test_a_tools_pose_beside_an_arm_is_kept_aside(tmp_path: Path) -> None:
    columns = arm_columns(TIME, POSITION)
    axes = ("x", "y", "z", "qw", "qx", "qy", "qz")
    columns |= {f"tool_{axis}": TIME for axis in axes}
    log = read_log(write_csv(tmp_path / "a.csv", columns), arm(tmp_path))
    check_motion(log)
    assert log.body is None
    np.testing.assert_allclose(log.recordings[0].extra["tool_qw"], TIME)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_lerobot_with_other_names_for_features_and_joints(
    tmp_path: Path, version: str
) -> None:
    theirs = [f"{name}.pos" for name in ("base", "elbow", "wrist")]
    model = arm(tmp_path)
    folder = write_lerobot(
        tmp_path / "set",
        {
            "state": (theirs, [POSITION, POSITION[:150]]),
            "observation.effort": (
                ["base", "elbow", "wrist"],
                [COMMAND, COMMAND[:150]],
            ),
            "action": (theirs, [COMMAND, COMMAND[:150]]),
        },
        listed=3,
        version=version,
    )
    names = {"state": "observation.state", "base": "shoulder"}
    log = read_log(folder, model, rename=names)
    check_motion(log, 1e-6)
    assert [part.rows for part in log.recordings] == [300, 150]
    # Single precision in the file, and even times all the same.
    np.testing.assert_allclose(np.diff(log.recordings[0].time), 0.02, atol=1e-12)
    np.testing.assert_allclose(log.recordings[0].torque, COMMAND, atol=1e-6)
    assert "Of 3 listed episodes 1 have no file." in log.notes


def test_lerobot_without_names_is_read_in_order(tmp_path: Path) -> None:
    parts = {"observation.state": (None, [POSITION]), "action": (None, [COMMAND])}
    log = read_log(write_lerobot(tmp_path / "set", parts), arm(tmp_path))
    check_motion(log)
    assert len(log.notes) == 2


def test_a_task_keeps_its_own_state_and_actions(tmp_path: Path) -> None:
    from rlco.gap.model import load_model
    from rlco.physics.spec.names import ACTION_NAMES, STATE_NAMES

    rng = np.random.default_rng(0)
    state, action = rng.normal(size=(2, 120, 7))
    scene = rng.normal(size=(120, 2))
    parts = {
        "observation.state": (list(STATE_NAMES), [state]),
        "observation.environment_state": (["red_cube.x", "red_cube.y"], [scene]),
        "action": (None, [action]),
    }
    folder = write_lerobot(tmp_path / "set", parts, fps=20)
    log = read_log(folder, load_model("robosuite:push_cube"))
    assert log.actuators == ACTION_NAMES
    assert log.joints == ()
    # A task's log has a tool and objects: joints that it lacks are no news.
    assert not [note for note in log.notes if "joint" in note]
    part = log.recordings[0]
    np.testing.assert_allclose(part.command, action, rtol=1e-6)
    np.testing.assert_allclose(part.extra["tool.y"], state[:, 1], rtol=1e-6)
    np.testing.assert_allclose(part.extra["red_cube.y"], scene[:, 1], rtol=1e-6)


def test_bam_keeps_the_bench_and_its_channels(tmp_path: Path) -> None:
    entries = [
        {
            "position": 0.5 * np.sin(3 * t),
            "speed": 1.5 * np.cos(3 * t),
            "goal_position": np.sin(3 * t),
            "load": 65533 if t > 1 else 2,
            "torque_enable": bool(t < 4),
            "timestamp": 0.25 + t,
        }
        for t in np.arange(1200) * 0.005
    ]
    run = {"mass": 0.5, "kp": 200, "trajectory": "sin", "entries": entries}
    (tmp_path / "one.json").write_text(json.dumps(run))
    xml = """<mujoco><worldbody><body><joint name="pin"/><geom size=".1"/></body>
    </worldbody><actuator><position joint="pin" kp="1"/></actuator></mujoco>"""
    log = read_log(tmp_path / "one.json", arm(tmp_path, xml))
    part = log.recordings[0]
    assert (log.joints, log.actuators) == (("pin",), ("pin",))
    assert part.facts == {"mass": 0.5, "kp": 200.0}
    assert part.name == "one sin"
    np.testing.assert_allclose(part.time[[0, -1]], [0.0, 5.995], atol=1e-9)
    assert part.extra["load"][[0, -1]].tolist() == [2.0, -3.0]
    assert part.extra["torque_enable"].sum() == 800
    np.testing.assert_allclose(part.velocity[0], [1.5])
