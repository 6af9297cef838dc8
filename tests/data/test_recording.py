"""Recorded sets are LeRobot's own, and unfinished ones are known as such."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from rlco.data import DemoWriter, load_demos
from rlco.errors import ConfigError, DataError, OutputExistsError
from rlco.keys import ACTION, IMAGE

TASKS = ("push the red cube", "push the blue cube")
FRAMES = ((TASKS[0],) * 4, (TASKS[1],) * 2 + (TASKS[0],), (TASKS[1],) * 5)
NAMES: dict[str, Any] = {
    "state_names": ["x", "y"],
    "action_names": ["dx", "dy", "grip"],
    "environment_state_names": ["cube"],
}


def frame(episode: int, t: int) -> dict[str, Any]:
    value = 10.0 * episode + t
    return {
        "state": np.array([value, -value], np.float32),
        "action": np.array([value, value + 0.25, -1.0], np.float32),
        "environment_state": np.array([value / 2], np.float32),
        "task": FRAMES[episode][t],
    }


def record(writer: DemoWriter, **extra: Any) -> None:
    for episode, tasks in enumerate(FRAMES):
        for t in range(len(tasks)):
            writer.add_frame(**frame(episode, t), **extra)
        writer.save_episode()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("recorded") / "set"
    with DemoWriter(root, fps=20, robot_type="panda", **NAMES) as writer:
        record(writer)
    return root


def test_lerobots_own_reader_opens_it(recorded: Path) -> None:
    from lerobot.datasets import LeRobotDataset

    dataset = LeRobotDataset("any/name", root=recorded, video_backend="pyav")
    assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (3, 12, 20)
    assert dataset.meta.robot_type == "panda"
    assert dataset.features["action"]["names"] == NAMES["action_names"]
    # Row 5 is frame 1 of episode 1: its value is 11.
    row = dataset[5]
    assert row["action"].tolist() == [11.0, 11.25, -1.0]
    assert row["observation.environment_state"].item() == 5.5
    assert row["task"] == TASKS[1]
    assert dataset[6]["task"] == TASKS[0]
    assert row["timestamp"].item() == pytest.approx(1 / 20)


def test_files_equal_those_of_lerobots_own_writer(
    recorded: Path, tmp_path: Path
) -> None:
    """The quick way for numbers leaves nothing out."""
    from lerobot.datasets import LeRobotDataset

    features = json.loads((recorded / "meta/info.json").read_text())["features"]
    ours = ("observation.state", "action", "observation.environment_state")
    theirs = LeRobotDataset.create(
        repo_id="local/set",
        root=tmp_path / "theirs",
        fps=20,
        robot_type="panda",
        features={
            k: {**features[k], "shape": (features[k]["shape"][0],)} for k in ours
        },
        use_videos=False,
        video_backend="pyav",
    )
    for episode, tasks in enumerate(FRAMES):
        for t in range(len(tasks)):
            values = frame(episode, t)
            renamed = {name: values[name.rpartition(".")[2]] for name in ours}
            theirs.add_frame({**renamed, "task": values["task"]})
        theirs.save_episode()
    theirs.finalize()

    def read(root: Path, name: str) -> Any:
        return json.loads((root / "meta" / name).read_text())

    assert read(recorded, "info.json") == read(tmp_path / "theirs", "info.json")
    assert read(recorded, "stats.json") == read(tmp_path / "theirs", "stats.json")
    tables = [
        pq.read_table(root / "data/chunk-000/file-000.parquet")
        for root in (recorded, tmp_path / "theirs")
    ]
    # LeRobot numbers the tasks of an episode in the order of a Python set.
    task_names = [
        pq.read_table(root / "meta/tasks.parquet").to_pydict()["task"]
        for root in (recorded, tmp_path / "theirs")
    ]
    assert sorted(task_names[0]) == sorted(task_names[1])
    described = [
        json.loads(table.schema.metadata[b"huggingface"])["info"] for table in tables
    ]
    assert described[0] == described[1]
    assert tables[0].drop(["task_index"]).equals(tables[1].drop(["task_index"]))
    episodes = [
        pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet")
        for root in (recorded, tmp_path / "theirs")
    ]
    assert set(episodes[0].column_names) == set(episodes[1].column_names)
    for name in ("length", "dataset_from_index", "dataset_to_index"):
        assert episodes[0][name].equals(episodes[1][name])


def test_large_data_are_split_over_files(tmp_path: Path) -> None:
    from lerobot.datasets import LeRobotDataset

    writer = DemoWriter(tmp_path / "set", fps=20, **NAMES)
    # LeRobot's own setting of the size of a file, here such that each is full; its
    # reader refuses the setting, so the file gets the usual one back.
    writer._dataset.meta.info.data_files_size_in_mb = 0
    record(writer)
    writer.close()
    info = tmp_path / "set/meta/info.json"
    info.write_text(info.read_text().replace('_in_mb": 0', '_in_mb": 100'))
    files = sorted((tmp_path / "set/data").rglob("*.parquet"))
    assert [file.name for file in files] == [f"file-00{i}.parquet" for i in range(3)]
    actions = load_demos(tmp_path / "set").frames()[ACTION]
    dataset = LeRobotDataset("any/name", root=tmp_path / "set", video_backend="pyav")
    for row in (0, 5, 11):
        torch.testing.assert_close(dataset[row]["action"], actions[row])


@pytest.mark.parametrize("video", [False, True], ids=["png", "video"])
def test_pictures_come_back(tmp_path: Path, video: bool) -> None:
    image = np.zeros((3, 64, 96), np.uint8)
    image[0, :32] = 200  # Red above, blue below.
    image[2, 32:] = 200
    with DemoWriter(
        tmp_path / "set",
        fps=20,
        camera="front",
        image_size=(64, 96),
        video=video,
        **NAMES,
    ) as writer:
        record(writer, image=image)
    images = load_demos(tmp_path / "set").frames()[IMAGE]
    assert images.shape == (12, 3, 64, 96)
    assert images.dtype == torch.uint8
    mean_error = (images.float() - torch.from_numpy(image)).abs().mean(dim=(1, 2, 3))
    assert mean_error.max() <= (4.0 if video else 0.0)


def test_statistics_are_in_order_whatever_the_process(tmp_path: Path) -> None:
    image = np.zeros((3, 64, 64), np.uint8)
    cameras: dict[str, Any] = {"camera": "front", "image_size": (64, 64)}
    with DemoWriter(tmp_path / "set", fps=20, **cameras, **NAMES) as writer:
        record(writer, image=image)
    features = list(json.loads((tmp_path / "set/meta/stats.json").read_text()))
    assert "observation.images.front" in features
    assert features == sorted(features)


def test_existing_folder_is_refused_untouched(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set/notes.txt").write_text("mine")
    with pytest.raises(OutputExistsError):
        DemoWriter(tmp_path / "set", fps=20, **NAMES)
    assert [file.name for file in (tmp_path / "set").iterdir()] == ["notes.txt"]


def test_interrupted_recording_is_known_and_its_episodes_are_kept(
    tmp_path: Path,
) -> None:
    def interrupted() -> None:
        with DemoWriter(tmp_path / "set", fps=20, **NAMES) as writer:
            record(writer)
            writer.add_frame(**frame(0, 0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with pytest.raises(DataError, match=r"unfinished recording .* delete meta/unfin"):
        load_demos(tmp_path / "set")
    (tmp_path / "set/meta/unfinished").unlink()
    assert load_demos(tmp_path / "set").meta.episode_lengths == (4, 3, 5)


def test_a_recording_that_fails_before_its_first_episode_leaves_no_folder(
    tmp_path: Path,
) -> None:
    def failed() -> None:
        with DemoWriter(tmp_path / "set", fps=20, **NAMES) as writer:
            writer.add_frame(**frame(0, 0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        failed()
    assert list(tmp_path.iterdir()) == []
    with DemoWriter(tmp_path / "set", fps=20, **NAMES) as writer:
        record(writer)  # the corrected program, with the same folder
    with pytest.raises(OutputExistsError) as caught:
        DemoWriter(tmp_path / "set", fps=20, **NAMES)
    assert "resume" not in str(caught.value)


def test_killed_recording_is_known(tmp_path: Path) -> None:
    writer = DemoWriter(tmp_path / "set", fps=20, **NAMES)
    record(writer)
    # As a kill leaves it; without the mark LeRobot's missing footers still tell.
    for mark in ("left", "removed"):
        if mark == "removed":
            (tmp_path / "set/meta/unfinished").unlink()
        with pytest.raises(DataError, match="unfinished recording"):
            load_demos(tmp_path / "set")


def test_frames_that_were_never_saved_are_not_lost_in_silence(tmp_path: Path) -> None:
    writer = DemoWriter(tmp_path / "set", fps=20, **NAMES)
    record(writer)
    writer.add_frame(**frame(0, 0))
    with pytest.raises(
        DataError, match=r"1 frames were added .* after the last episode"
    ):
        writer.close()


def test_discarded_episode_is_not_in_the_set(tmp_path: Path) -> None:
    with DemoWriter(tmp_path / "set", fps=20, **NAMES) as writer:
        writer.add_frame(**frame(0, 3))
        writer.discard_episode()
        record(writer)
        assert (writer.saved_episodes, writer.pending_frames) == (3, 0)
    assert load_demos(tmp_path / "set").meta.episode_lengths == (4, 3, 5)


@pytest.fixture(scope="module")
def open_writer(tmp_path_factory: pytest.TempPathFactory) -> DemoWriter:
    return DemoWriter(tmp_path_factory.mktemp("open") / "set", fps=20, **NAMES)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"action": [0.0] * 4}, r"action has shape \(4,\), but 3 names"),
        ({"state": [0.0, np.nan]}, "observation.state of frame 0 of episode 0 is NaN"),
        ({"environment_state": None}, "observation.environment_state is not given"),
        ({"image": np.zeros((3, 4, 4), np.uint8)}, "image is given, but .* no camera"),
        ({"task": " "}, "task is an empty text"),
    ],
)
def test_frames_that_cannot_be_recorded(
    open_writer: DemoWriter, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(DataError, match=message):
        open_writer.add_frame(**(frame(0, 0) | change))
    with pytest.raises(DataError, match="without frames cannot be saved"):
        open_writer.save_episode()


def test_all_problems_of_the_options_are_told_together(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        DemoWriter(
            tmp_path / "set",
            fps=0,
            state_names=["x", "x"],
            action_names=[],
            camera="front",
        )
    assert len(error.value.problems) == 4
    assert not (tmp_path / "set").exists()
