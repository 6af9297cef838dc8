"""LeRobot folders: read right, and every defect told in one sentence."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rlco.errors import DataError
from rlco.lerobot_files import iterate_images, read_columns, read_folder

REAL = Path(__file__).parents[3] / "shared" / "data" / "real" / "lerobot_g1"
FPS = 10
LENGTHS = (4, 3, 5)
CAMERA = "observation.images.front"


def state_of(episode: int, length: int) -> np.ndarray:
    """State of frame t: 100 episode + t in its first number, minus that in the 2nd."""
    first = 100.0 * episode + np.arange(length)
    return np.stack([first, -first], axis=1).astype(np.float32)


def shade(episode: int, frame: int) -> int:
    """One grey value a frame, 15 apart, so that neighbours cannot be confused."""
    return 20 + 60 * episode + 15 * frame


def write_episode(file: Path, episode: int, state: np.ndarray) -> None:
    length = len(state)
    file.parent.mkdir(parents=True, exist_ok=True)
    columns = {
        "observation.state": pa.FixedSizeListArray.from_arrays(state.ravel(), 2),
        # Some recorders write plain lists.
        "action": pa.array((state[:, :1] + 0.5).tolist(), pa.list_(pa.float32())),
        "timestamp": pa.array((np.arange(length) / FPS).astype(np.float32)),
        "frame_index": pa.array(np.arange(length)),
        "episode_index": pa.array(np.full(length, episode)),
        "task_index": pa.array(np.full(length, episode % 2)),
    }
    pq.write_table(pa.table(columns), file)


def write_video(file: Path, episode: int, length: int) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(file), "w") as container:
        stream = container.add_stream("mpeg4", rate=FPS)
        stream.width, stream.height, stream.pix_fmt = 32, 16, "yuv420p"
        for t in range(length):
            pixels = np.full((16, 32, 3), shade(episode, t), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, "rgb24")))
        container.mux(stream.encode(None))


@pytest.fixture
def v2(tmp_path: Path) -> Path:
    """A v2.1 folder: three episodes, two tasks, one camera kept as video."""
    root = tmp_path / "v2"
    number = {"dtype": "int64", "shape": [1], "names": None}
    info = {
        "codebase_version": "v2.1",
        "robot_type": "arm",
        "fps": FPS,
        "chunks_size": 1000,
        "total_episodes": len(LENGTHS),
        "data_path": "data/chunk-{episode_chunk:03d}"
        "/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}"
        "/episode_{episode_index:06d}.mp4",
        "features": {
            "observation.state": {
                "dtype": "float32",
                "shape": [2],
                "names": [["x", "y"]],
            },
            "action": {"dtype": "float32", "shape": [1], "names": {"motors": ["grip"]}},
            CAMERA: {"dtype": "video", "shape": [16, 32, 3], "names": ["h", "w", "c"]},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            "frame_index": number,
            "episode_index": number,
            "task_index": number,
        },
    }
    (root / "meta").mkdir(parents=True)
    (root / "meta/info.json").write_text(json.dumps(info))
    tasks = [{"task_index": i, "task": t} for i, t in enumerate(["push", "pick"])]
    (root / "meta/tasks.jsonl").write_text("\n".join(map(json.dumps, tasks)))
    episodes = [
        {"episode_index": i, "length": length, "tasks": ["push"]}
        for i, length in enumerate(LENGTHS)
    ]
    (root / "meta/episodes.jsonl").write_text("\n".join(map(json.dumps, episodes)))
    for i, length in enumerate(LENGTHS):
        write_episode(data_file(root, i), i, state_of(i, length))
        write_video(video_file(root, i), i, length)
    return root


def data_file(root: Path, episode: int) -> Path:
    return root / f"data/chunk-000/episode_{episode:06d}.parquet"


def video_file(root: Path, episode: int) -> Path:
    return root / f"videos/chunk-000/{CAMERA}/episode_{episode:06d}.mp4"


def edit_info(root: Path, change: Callable[[dict[str, Any]], object]) -> None:
    file = root / "meta/info.json"
    info = json.loads(file.read_text())
    change(info)
    file.write_text(json.dumps(info))


def cut(file: Path, share: float = 0.6) -> None:
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])


def test_neither_torch_nor_lerobot_is_imported() -> None:
    code = (
        "import sys, rlco.lerobot_files\n"
        "heavy = {'torch', 'lerobot', 'datasets', 'pandas'} & set(sys.modules)\n"
        "sys.exit(', '.join(heavy) or 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_v2_metadata(v2: Path) -> None:
    folder = read_folder(v2)
    assert (folder.version, folder.fps, folder.robot_type) == ("v2.1", 10.0, "arm")
    assert folder.features["observation.state"].names == ("x", "y")
    assert folder.features["action"].names == ("grip",)
    assert folder.features[CAMERA].names is None
    assert folder.cameras == (CAMERA,)
    assert folder.tasks == {0: "push", 1: "pick"}
    assert [e.length for e in folder.episodes] == list(LENGTHS)


def test_v2_columns_of_chosen_episodes_in_the_order_asked_for(v2: Path) -> None:
    folder = read_folder(v2, episodes=[2, 0])
    columns = read_columns(folder, ["observation.state", "action", "task_index"])
    expected = np.concatenate([state_of(2, 5), state_of(0, 4)])
    np.testing.assert_array_equal(columns["observation.state"], expected)
    # One number a frame comes without an axis of length one.
    np.testing.assert_array_equal(columns["action"], expected[:, 0] + 0.5)
    assert columns["task_index"].dtype == np.int64


def test_frames_out_of_order_in_the_file_are_put_in_order(v2: Path) -> None:
    file = data_file(v2, 0)
    pq.write_table(pq.read_table(file).take([2, 0, 3, 1]), file)
    states = read_columns(read_folder(v2, episodes=[0]), ["observation.state"])
    np.testing.assert_array_equal(states["observation.state"], state_of(0, 4))


def test_v2_video_frames_match_their_timestamps(v2: Path) -> None:
    for i, images in enumerate(iterate_images(read_folder(v2), CAMERA)):
        assert images.shape == (LENGTHS[i], 3, 16, 32)
        assert images.dtype == np.uint8
        expected = [shade(i, t) for t in range(LENGTHS[i])]
        np.testing.assert_allclose(images.mean(axis=(1, 2, 3)), expected, atol=4)


def test_rename_gives_features_our_names(v2: Path) -> None:
    folder = read_folder(v2, rename={"action": "gripper", CAMERA: "front"})
    assert "action" not in folder.features
    assert folder.cameras == ("front",)
    assert len(read_columns(folder, ["gripper"])["gripper"]) == sum(LENGTHS)
    assert next(iterate_images(folder, "front")).shape == (4, 3, 16, 32)


def drop_info(root: Path) -> None:
    (root / "meta/info.json").unlink()


def break_json(root: Path) -> None:
    cut(root / "meta/info.json")


def drop_fps(root: Path) -> None:
    edit_info(root, lambda info: info.pop("fps"))


def drop_shape(root: Path) -> None:
    edit_info(root, lambda info: info["features"]["action"].pop("shape"))


def make_v20(root: Path) -> None:
    edit_info(root, lambda info: info.update(codebase_version="v2.0"))


def drop_list(root: Path) -> None:
    (root / "meta/episodes.jsonl").unlink()


def break_list(root: Path) -> None:
    cut(root / "meta/episodes.jsonl", 0.9)


def empty_list(root: Path) -> None:
    (root / "meta/episodes.jsonl").write_text("")


def mark_unfinished(root: Path) -> None:
    (root / "meta/unfinished").touch()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (shutil.rmtree, "does not exist; give the folder that holds meta/info.json"),
        (drop_info, "is not a LeRobot data set: it has no meta/info.json"),
        (break_json, "info.json' is truncated or damaged"),
        (drop_fps, "info.json' lacks fps"),
        (drop_shape, "feature 'action' of data set .* has no proper dtype and shape"),
        (make_v20, "LeRobot version 'v2.0'; v2.1 and v3 are read"),
        (drop_list, "episodes.jsonl' is missing"),
        (break_list, "episodes.jsonl' is truncated or damaged"),
        (empty_list, "holds no episodes"),
        (mark_unfinished, "is an unfinished recording"),
    ],
)
def test_defects_of_the_metadata(
    v2: Path, damage: Callable[[Path], object], message: str
) -> None:
    damage(v2)
    with pytest.raises(DataError, match=message):
        read_folder(v2)


def test_missing_episode_files_are_named_and_the_present_ones_offered(v2: Path) -> None:
    data_file(v2, 1).unlink()
    data_file(v2, 2).unlink()
    with pytest.raises(
        DataError, match=r"lists episodes 1-2, .* are there .* out of 0"
    ):
        read_folder(v2)
    folder = read_folder(v2, episodes=[0])
    assert len(read_columns(folder, ["action"])["action"]) == LENGTHS[0]


@pytest.mark.parametrize(
    ("episodes", "culprit"),
    [
        ([0, 1, 2, 3], "episodes=0-3 .* asks for 3, which it does not have"),
        ([0, 7, 1, 5], "asks for 5, 7, which it does not have"),
        ([0, 1, 0], "asks for 0 more than once"),
        ([], "asks for none"),
    ],
)
def test_episodes_that_cannot_be_selected(
    v2: Path, episodes: list[int], culprit: str
) -> None:
    with pytest.raises(DataError, match=rf"{culprit}; .*out of 0-2"):
        read_folder(v2, episodes=episodes)


@pytest.mark.parametrize(
    ("rename", "message"),
    [
        ({"actoin": "action"}, "did you mean 'action'"),
        ({"action": "observation.state"}, "a second 'observation.state'"),
        ({"action": "a", "timestamp": "a"}, "one name to several features"),
    ],
)
def test_renamings_that_cannot_be(
    v2: Path, rename: dict[str, str], message: str
) -> None:
    with pytest.raises(DataError, match=message):
        read_folder(v2, rename=rename)


def test_missing_feature_lists_those_there_and_offers_rename(v2: Path) -> None:
    with pytest.raises(
        DataError, match=r"has no feature 'observation.states'"
    ) as error:
        read_columns(read_folder(v2), ["observation.states"])
    message = str(error.value)
    assert "did you mean 'observation.state'" in message
    assert 'rename={"its name": "observation.states"}' in message
    assert f"it has observation.state, action, {CAMERA}, timestamp" in message


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_bad_number_is_located(v2: Path, value: float) -> None:
    state = state_of(1, 3)
    state[2, 1] = value
    write_episode(data_file(v2, 1), 1, state)
    message = "'observation.state' .* 1 of 8 frames, first in episode 1 at frame 2"
    with pytest.raises(DataError, match=message):
        read_columns(read_folder(v2, episodes=[2, 1]), ["observation.state"])
    # The other columns of the same file can be read.
    read_columns(read_folder(v2), ["action"])


def replace_column(root: Path, name: str, column: pa.Array | None) -> None:
    table = pq.read_table(data_file(root, 0))
    table = table.drop([name])
    if column is not None:
        table = table.append_column(name, column)
    pq.write_table(table, data_file(root, 0))


@pytest.mark.parametrize(
    ("column", "message"),
    [
        (None, "has no column action"),
        (pa.array([0.1, None, 0.3, 0.4]), "'action' .* has missing values"),
        (pa.array([[0.1, 0.2]] * 4), "holds 2 numbers per frame, .* says 1"),
        (pa.array([[0.1], [], [0.3], [0.4]]), "holds 0.75 numbers per frame"),
        (pa.array(["a", "b", "c", "d"]), "holds string, not numbers"),
    ],
)
def test_columns_that_are_not_as_listed(
    v2: Path, column: pa.Array | None, message: str
) -> None:
    replace_column(v2, "action", column)
    with pytest.raises(DataError, match=message):
        read_columns(read_folder(v2), ["action"])


def test_truncated_parquet_file(v2: Path) -> None:
    cut(data_file(v2, 1))
    with pytest.raises(DataError, match=r"episode_000001.parquet' is truncated"):
        read_columns(read_folder(v2), ["action"])


def test_episode_of_another_length_than_listed(v2: Path) -> None:
    write_episode(data_file(v2, 2), 2, state_of(2, 4))
    with pytest.raises(DataError, match=r"episode 2 .* holds 4 frames, not .* 0 to 4"):
        read_columns(read_folder(v2), ["action"])


def test_pictures_are_no_numbers_and_numbers_no_pictures(v2: Path) -> None:
    with pytest.raises(DataError, match="'video' and holds no numbers"):
        read_columns(read_folder(v2), [CAMERA])
    with pytest.raises(
        DataError, match=f"'action' .* is not a camera; cameras: {CAMERA}"
    ):
        iterate_images(read_folder(v2), "action")


def longer_episode(root: Path) -> None:
    write_video(video_file(root, 1), 1, 2)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda root: video_file(root, 1).unlink(), "of episode 1 is missing; copy it"),
        (lambda root: cut(video_file(root, 1), 0.5), "000001.mp4' cannot be decoded"),
        (longer_episode, "no image for frame 2 of episode 1, at 0.200 s"),
    ],
)
def test_defects_of_videos(
    v2: Path, damage: Callable[[Path], object], message: str
) -> None:
    damage(v2)
    with pytest.raises(DataError, match=message):
        list(iterate_images(read_folder(v2), CAMERA))


@pytest.fixture(scope="module", params=[False, True], ids=["png", "video"])
def lerobot_set(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Path, bool]:
    """A v3 set by LeRobot itself: as finished, and as it lay just before that."""
    from lerobot import datasets

    video = bool(request.param)
    folder = tmp_path_factory.mktemp("lerobot")
    root, killed = folder / "finished", folder / "killed"
    dataset = datasets.LeRobotDataset.create(
        repo_id="local/set",
        root=root,
        fps=FPS,
        features={
            "observation.state": {"dtype": "float32", "shape": (2,), "names": None},
            "action": {"dtype": "float32", "shape": (1,), "names": ["grip"]},
            CAMERA: {
                "dtype": "video" if video else "image",
                "shape": (64, 96, 3),
                "names": ["height", "width", "channels"],
            },
        },
        use_videos=video,
        video_backend="pyav",
    )
    for i, length in enumerate(LENGTHS):
        for t, state in enumerate(state_of(i, length)):
            image = np.full((64, 96, 3), shade(i, t), np.uint8)
            image[:32, :, 0] = 0  # No red in the upper half.
            dataset.add_frame(
                {
                    "observation.state": state,
                    "action": state[:1],
                    CAMERA: image,
                    "task": ["push", "pick"][i % 2],
                }
            )
        dataset.save_episode()
    # What a killed recording leaves behind.
    shutil.copytree(root, killed)
    dataset.finalize()
    return root, killed, video


def test_v3_round_trip(lerobot_set: tuple[Path, Path, bool]) -> None:
    root, _, video = lerobot_set
    folder = read_folder(root, episodes=[2, 1])
    assert folder.version == "v3.0"
    assert folder.tasks == {0: "push", 1: "pick"}
    columns = read_columns(folder, ["observation.state", "action", "task_index"])
    expected = np.concatenate([state_of(2, 5), state_of(1, 3)])
    np.testing.assert_array_equal(columns["observation.state"], expected)
    np.testing.assert_array_equal(columns["action"], expected[:, 0])
    assert columns["task_index"].tolist() == [0] * 5 + [1] * 3
    for i, images in zip((2, 1), iterate_images(folder, CAMERA), strict=True):
        shades = np.array([shade(i, t) for t in range(LENGTHS[i])])
        assert images.shape == (LENGTHS[i], 3, 64, 96)
        # Upright, red first; PNG exact, video within its compression.
        tolerance = 5.0 if video else 0.0
        np.testing.assert_allclose(
            images[:, 2].mean(axis=(1, 2)), shades, atol=tolerance
        )
        np.testing.assert_allclose(
            images[:, 0, 40:].mean(axis=(1, 2)), shades, atol=tolerance
        )
        np.testing.assert_allclose(images[:, 0, :24].mean(axis=(1, 2)), 0, atol=12)


def test_unfinished_lerobot_recording_is_told(
    lerobot_set: tuple[Path, Path, bool],
) -> None:
    _, killed, _ = lerobot_set
    with pytest.raises(DataError, match=r"unfinished recording .*finalize\(\) was"):
        read_folder(killed)


def test_truncated_v3_file_is_not_called_unfinished(
    lerobot_set: tuple[Path, Path, bool], tmp_path: Path
) -> None:
    root = shutil.copytree(lerobot_set[0], tmp_path / "set")
    cut(root / "data/chunk-000/file-000.parquet")
    with pytest.raises(DataError, match=r"file-000.parquet' is truncated or damaged"):
        read_columns(read_folder(root), ["action"])


def test_episodes_cut_from_the_v3_table_are_noticed(
    lerobot_set: tuple[Path, Path, bool], tmp_path: Path
) -> None:
    root = shutil.copytree(lerobot_set[0], tmp_path / "set")
    table = root / "meta/episodes/chunk-000/file-000.parquet"
    pq.write_table(pq.read_table(table).slice(0, 2), table)
    with pytest.raises(DataError, match="2 of 3 episodes were written out"):
        read_folder(root)


@pytest.mark.parametrize("lerobot_set", [False], ids=["png"], indirect=True)
def test_damaged_image_is_located(
    lerobot_set: tuple[Path, Path, bool], tmp_path: Path
) -> None:
    root, _, _ = lerobot_set
    root = shutil.copytree(root, tmp_path / "set")
    file = root / "data/chunk-000/file-000.parquet"
    table = pq.read_table(file)
    cells = table[CAMERA].to_pylist()
    cells[5]["bytes"] = cells[5]["bytes"][:40]
    position = table.column_names.index(CAMERA)
    column = pa.array(cells, table.schema.field(CAMERA).type)
    pq.write_table(table.set_column(position, CAMERA, column), file)
    # Row 5 is frame 1 of episode 1: episode 0 has 4 frames.
    with pytest.raises(DataError, match=r"frame 1 of episode 1 .* is damaged"):
        list(iterate_images(read_folder(root), CAMERA))


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real data set at {REAL}")
def test_real_data_set_of_which_a_part_is_there() -> None:
    with pytest.raises(DataError, match=r"lists episodes 20-99, .* out of 0-19"):
        read_folder(REAL)
    folder = read_folder(REAL, episodes=range(20))
    columns = read_columns(folder, ["observation.state", "action"])
    # Its list gives 479 frames to episode 0 and 393 to episode 1.
    assert [e.length for e in folder.episodes[:2]] == [479, 393]
    total = sum(e.length for e in folder.episodes)
    assert columns["action"].shape == (total, 26)
    # rms(action - state) was measured as 0.012 to 0.052 rad.
    error = np.sqrt(
        np.mean((columns["action"] - columns["observation.state"]) ** 2, axis=0)
    )
    assert 0.01 < np.median(error) < 0.06
    with pytest.raises(DataError, match="episode 0 is missing"):
        list(iterate_images(folder, "observation.images.cam_high"))


def test_a_feature_that_was_renamed_away_is_not_offered_again(v2: Path) -> None:
    folder = read_folder(v2, rename={"observation.state": "observation"})
    with pytest.raises(DataError, match="gave it the name 'observation'; leave that"):
        read_columns(folder, ["observation.state"])
