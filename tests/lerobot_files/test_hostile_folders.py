"""LeRobot folders that were made to do harm: nothing is read, run or held in memory."""

from __future__ import annotations

import io
import json
import os
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import PIL.Image
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rlco.errors import DataError
from rlco.files import sizes
from rlco.lerobot_files import (
    check_stored_sizes,
    images,
    iterate_images,
    read_columns,
    read_folder,
    tables,
)

FIRST = Path(__file__).parents[1] / "first_edition"
CAMERA = "observation.images.front"
STORED = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"


def png(width: int, height: int) -> bytes:
    stream = io.BytesIO()
    PIL.Image.new("RGB", (width, height)).save(stream, "PNG")
    return stream.getvalue()


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A folder of one episode of three frames, with images as PNG."""
    root = tmp_path / "demos"
    number = {"dtype": "int64", "shape": [1]}
    info = {
        "codebase_version": "v2.1",
        "fps": 10,
        "features": {
            "observation.state": {"dtype": "float32", "shape": [1]},
            CAMERA: {"dtype": "image", "shape": [16, 32, 3]},
            "frame_index": number,
            "episode_index": number,
        },
    }
    (root / "meta").mkdir(parents=True)
    (root / "meta/info.json").write_text(json.dumps(info))
    (root / "meta/tasks.jsonl").write_text('{"task_index": 0, "task": "push"}\n')
    (root / "meta/episodes.jsonl").write_text('{"episode_index": 0, "length": 3}\n')
    write_frames(data_file(root), png(32, 16))
    return root


def data_file(root: Path) -> Path:
    return root / "data/chunk-000/episode_000000.parquet"


def write_frames(file: Path, image: bytes, frames: int = 3) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    columns = {
        "observation.state": pa.array(np.arange(frames) + 0.5, pa.float32()),
        CAMERA: pa.array([{"bytes": image, "path": None}] * frames),
        "frame_index": pa.array(np.arange(frames)),
        "episode_index": pa.array(np.zeros(frames, np.int64)),
    }
    pq.write_table(pa.table(columns), file)


def edit(root: Path, **changes: Any) -> None:
    file = root / "meta/info.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def read(root: Path) -> None:
    folder = read_folder(root)
    read_columns(folder, ["observation.state"])
    list(iterate_images(folder, CAMERA))


def test_the_folder_as_it_is_can_be_read(root: Path) -> None:
    edit(root, data_path=STORED)
    read(root)


# -- Places ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("template", "message"),
    [
        ("../secret/episode_{episode_index:06d}.parquet", "leads out of it"),
        ("data/../../secret/{episode_index}", "leads out of it"),
        ("/etc/{episode_index}", "leads out of it, to '/etc/0'"),
        ("{episode_index.__class__}", "no other fields than {episode_index}"),
        ("{episode_index.real.__class__.__mro__}", "no other fields than"),
        ("{episode_index!r}", "no other fields than"),
        ("{episode_index:999999999d}", "no other fields than"),
        ("{episode_index:{episode_chunk}}", "no other fields than"),
        ("{0}", "no other fields than"),
        ("{", "no other fields than"),
        ("data/\0{episode_index}", "leads out of it"),
    ],
)
def test_a_path_that_is_none_of_the_data_set(
    root: Path, template: str, message: str
) -> None:
    outside = root.parent / "secret/episode_000000.parquet"
    write_frames(outside, png(32, 16))
    edit(root, data_path=template)
    with pytest.raises(DataError, match=message):
        read_folder(root)


def test_a_camera_whose_name_is_a_path(root: Path) -> None:
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features["../../secret"] = {"dtype": "video", "shape": [16, 32, 3]}
    edit(root, features=features)
    with pytest.raises(DataError, match=r"video_path of data set .* leads out of it"):
        read_folder(root)


@pytest.mark.parametrize(
    "name", ["meta/info.json", "meta/tasks.jsonl", "meta/episodes.jsonl", "data"]
)
def test_a_link_that_leads_out(root: Path, name: str) -> None:
    outside = root.parent / "outside"
    (root / name).rename(outside)
    (root / name).symlink_to(outside)
    with pytest.raises(DataError, match="is outside of the data set"):
        read(root)


def test_links_of_a_hugging_face_cache_are_followed(root: Path) -> None:
    cache = root.parent / "datasets--me--demos"
    snapshot = cache / "snapshots" / "0123abc"
    (cache / "blobs").mkdir(parents=True)
    for number, file in enumerate(sorted(root.rglob("*.*"))):
        if file.is_file():
            blob = file.rename(cache / "blobs" / str(number))
            link = snapshot / file.relative_to(root)
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(blob)
    read(snapshot)


def test_links_in_a_circle(root: Path) -> None:
    data_file(root).unlink()
    data_file(root).symlink_to(data_file(root))
    with pytest.raises(DataError):
        read(root)


# -- Sizes -----------------------------------------------------------------------------


def test_an_image_larger_than_declared_is_not_decoded(root: Path) -> None:
    write_frames(data_file(root), png(2000, 2000))
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match=r"2000 pixels wide .* \[16, 32, 3\]"):
            read(root)
        assert tracemalloc.get_traced_memory()[1] < 10e6
    finally:
        tracemalloc.stop()


def test_a_declared_image_larger_than_any_camera_has(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(images, "_MOST_PIXELS", 500)
    with pytest.raises(DataError, match="512 pixels, and at most 500"):
        read(root)


@pytest.mark.parametrize("video", [False, True])
def test_an_episode_of_more_pixels_than_there_is_memory_for(
    root: Path, monkeypatch: pytest.MonkeyPatch, video: bool
) -> None:
    if video:
        film(root, coded("mpeg4"))
    monkeypatch.setattr(sizes, "_memory", lambda: 2 * 3 * 3 * 16 * 32 - 1)
    with pytest.raises(DataError, match=r"the 3 images of episode 0, 32 .* episodes="):
        read(root)
    monkeypatch.setattr(sizes, "_memory", lambda: 2 * 3 * 3 * 16 * 32)
    read(root)


def test_images_of_an_episode_that_differ_in_size(root: Path) -> None:
    table = pq.read_table(data_file(root))
    at = table.schema.get_field_index(CAMERA)
    cells = [{"bytes": png(*size)} for size in [(32, 16), (16, 32), (32, 16)]]
    pq.write_table(table.set_column(at, CAMERA, pa.array(cells)), data_file(root))
    with pytest.raises(DataError, match=r"episode 0 differ in size: \(16, 32\) and"):
        read(root)


def test_images_are_in_memory_once(root: Path) -> None:
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features[CAMERA]["shape"] = [1000, 1000, 3]
    edit(root, features=features)
    write_frames(data_file(root), png(1000, 1000), 40)
    listed = {"episode_index": 0, "length": 40}
    (root / "meta/episodes.jsonl").write_text(json.dumps(listed))
    tracemalloc.start()
    try:
        (found,) = iterate_images(read_folder(root), CAMERA)
        assert tracemalloc.get_traced_memory()[1] < 1.2 * found.nbytes
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("allowed", "most"), [("max\n", None), ("1000\n", 1000), (None, None)]
)
def test_a_container_s_memory_is_the_memory(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    allowed: str | None,
    most: int | None,
) -> None:
    monkeypatch.setattr(sizes, "_CONTAINER", tmp_path / "none")
    machine = sizes._memory()
    assert machine > 10**8
    if allowed is not None:
        (tmp_path / "memory.max").write_text(allowed)
        monkeypatch.setattr(sizes, "_CONTAINER", tmp_path / "memory.max")
    assert sizes._memory() == (most or machine)


def test_an_episode_of_more_frames_than_any_memory_holds(root: Path) -> None:
    listed = {"episode_index": 0, "length": 10**12}
    (root / "meta/episodes.jsonl").write_text(json.dumps(listed))
    with pytest.raises(DataError, match="holds 3 frames, not exactly the frames 0 to"):
        read(root)


def test_numbers_that_a_small_file_repeats_without_end(root: Path) -> None:
    rows = 8_000_000
    zeros = pa.DictionaryArray.from_arrays(
        pa.array(np.zeros(rows, np.int8)), pa.array([0])
    ).cast(pa.int64())
    names = ["observation.state", "frame_index", "episode_index"]
    pq.write_table(pa.table(dict.fromkeys(names, zeros)), data_file(root))
    assert data_file(root).stat().st_size < 2e6
    with pytest.raises(DataError, match=r"declares \d+.0 MB of numbers"):
        read_columns(read_folder(root), ["observation.state"])


def test_an_image_that_a_small_file_repeats_without_end(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sizes, "_FREE", 10**6)
    rows, image = 1000, np.random.default_rng(0).bytes(10_000)
    columns = {
        CAMERA: pa.array([{"bytes": image}] * rows),
        "frame_index": pa.array(np.arange(rows)),
        "episode_index": pa.array(np.zeros(rows, np.int64)),
    }
    pq.write_table(pa.table(columns), data_file(root))
    assert data_file(root).stat().st_size < 100_000
    with pytest.raises(DataError, match=r"declares 1\.\d MB of numbers"):
        next(iterate_images(read_folder(root), CAMERA))


def test_a_large_image_that_a_file_repeats_is_read_row_by_row(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Small rows come first, so that nobody concludes from them how large all are."""
    monkeypatch.setattr(sizes, "_FREE", 60 * 10**6)
    large = 10 * 2**20
    values = pa.array([b"small", bytes(large)])
    which = pa.array([0] * 200 + [1] * 128, pa.int32())
    rows = len(which)
    repeated = pa.StructArray.from_arrays(
        [pa.DictionaryArray.from_arrays(which, values)], ["bytes"]
    )
    columns = {
        CAMERA: repeated,
        "frame_index": pa.array(np.arange(rows)),
        "episode_index": pa.array(np.zeros(rows, np.int64)),
    }
    table = pa.table(columns)
    pq.write_table(table, data_file(root), compression="zstd", store_schema=False)
    assert data_file(root).stat().st_size < 10_000
    pool = pa.proxy_memory_pool(pa.default_memory_pool())
    usual = pa.default_memory_pool()
    pa.set_memory_pool(pool)
    try:
        with pytest.raises(DataError, match=r"declares \d+\.\d MB of numbers"):
            next(iterate_images(read_folder(root), CAMERA))
    finally:
        pa.set_memory_pool(usual)
    assert pool.max_memory() < 20 * large


def test_texts_in_many_rows_are_read_as_they_are(root: Path) -> None:
    texts = [f"{row} of many" for row in range(2000)]
    file = root / "texts.parquet"
    pq.write_table(pa.table({"task": texts}), file, row_group_size=700)
    assert tables.read_table(file)["task"].to_pylist() == texts


# -- Films -----------------------------------------------------------------------------


def film(root: Path, write: Callable[[Path], object]) -> None:
    """Make the camera one that is kept as video."""
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features[CAMERA]["dtype"] = "video"
    features["timestamp"] = {"dtype": "float32", "shape": [1]}
    edit(root, features=features)
    table = pq.read_table(data_file(root)).drop_columns([CAMERA])
    times = pa.array([0.0, 0.1, 0.2], pa.float32())
    pq.write_table(table.append_column("timestamp", times), data_file(root))
    file = root / f"videos/chunk-000/{CAMERA}/episode_000000.mp4"
    file.parent.mkdir(parents=True)
    write(file)


def coded(codec: str, width: int = 32, height: int = 16) -> Callable[[Path], object]:
    def write(file: Path) -> None:
        form = "mp4" if codec == "mpeg4" else "avi"
        with av.open(str(file), "w", format=form) as container:
            stream = container.add_stream(codec, rate=10)
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            image = av.VideoFrame.from_ndarray(
                np.zeros((height, width, 3), np.uint8), "rgb24"
            )
            for _ in range(3):
                container.mux(stream.encode(image))
            container.mux(stream.encode(None))

    return write


def playlist(file: Path) -> None:
    outside = file.parents[4] / "secret.mp4"
    coded("mpeg4")(outside)
    file.write_text(f"#EXTM3U\n#EXTINF:1,\n{outside}\n#EXT-X-ENDLIST\n")


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (coded("mpeg4", 640, 480), "is 640 pixels wide and 480 high, but meta"),
        (coded("mpeg2video"), "is coded as 'mpeg2video', and h264, hevc"),
        (playlist, "cannot be decoded"),
    ],
)
def test_films_that_are_not_decoded(
    root: Path, write: Callable[[Path], object], message: str
) -> None:
    film(root, write)
    with pytest.raises(DataError, match=message):
        read(root)


def test_a_film_as_declared_is_decoded(root: Path) -> None:
    film(root, coded("mpeg4"))
    (frames,) = iterate_images(read_folder(root), CAMERA)
    assert frames.shape == (3, 3, 16, 32)


# -- Pipes ------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["info.json", "tasks.jsonl", "episodes.jsonl"])
def test_a_pipe_is_not_waited_for(root: Path, name: str) -> None:
    (root / "meta" / name).unlink()
    os.mkfifo(root / "meta" / name)
    with pytest.raises(DataError, match=rf"{name}' is no file|has no meta/{name}"):
        read_folder(root)


@pytest.mark.parametrize(
    "name", ["tasks.parquet", "episodes/chunk-000/file-000.parquet"]
)
def test_a_pipe_in_the_place_of_a_table(tmp_path: Path, name: str) -> None:
    root = tmp_path / "demos"
    shutil.copytree(FIRST / "demos" / "sim", root)
    (root / "meta" / name).unlink()
    os.mkfifo(root / "meta" / name)
    with pytest.raises(DataError, match=rf"{name}' is no file"):
        read_folder(root)


def test_a_pipe_in_the_place_of_frames(root: Path) -> None:
    data_file(root).unlink()
    os.mkfifo(data_file(root))
    with pytest.raises(DataError, match=r"\.parquet"):
        read(root)


# -- Types -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [
        {"features": [1]},
        {"features": {"observation.state": {"dtype": "float32", "shape": [-1]}}},
        {"features": {"observation.state": {"dtype": "float32", "shape": [10**400]}}},
        {"features": {"observation.state": 3}},
        {"fps": "fast"},
        {"fps": -1},
        {"fps": 10**400},
        {"chunks_size": "x"},
        {"chunks_size": -1},
        {"codebase_version": 3},
        {"data_path": 5},
        {"robot_type": {"name": "arm"}},
    ],
)
def test_fields_of_another_type(root: Path, change: dict[str, Any]) -> None:
    edit(root, **change)
    with pytest.raises(DataError, match=r"meta/info\.json|data set"):
        read_folder(root)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("info.json", "[" * 100_000),
        ("info.json", "[1]"),
        ("info.json", "\xff"),
        ("tasks.jsonl", "3"),
        ("tasks.jsonl", '{"task_index": "x", "task": "push"}'),
        ("tasks.jsonl", '{"task_index": 0}'),
        ("episodes.jsonl", '{"episode_index": 0.5, "length": 3}'),
        ("episodes.jsonl", '{"episode_index": -1, "length": 3}'),
        ("episodes.jsonl", '{"episode_index": null, "length": 3}'),
    ],
)
def test_damaged_lists(root: Path, name: str, text: str) -> None:
    (root / "meta" / name).write_bytes(text.encode("latin-1"))
    with pytest.raises(DataError, match=name):
        read_folder(root)


def test_names_nested_without_end(root: Path) -> None:
    names = "[" * 980 + "]" * 980
    info = (root / "meta/info.json").read_text()
    nested = info.replace('"shape": [1]', f'"shape": [1], "names": {names}', 1)
    (root / "meta/info.json").write_text(nested)
    with pytest.raises(DataError, match=r"info\.json' is truncated or damaged"):
        read_folder(root)


def test_two_columns_of_one_name(root: Path) -> None:
    table = pq.read_table(data_file(root))
    twice = table.append_column("frame_index", table["frame_index"])
    pq.write_table(twice, data_file(root))
    with pytest.raises(DataError, match="has 1 column twice, such as 'frame_index'"):
        read(root)


def test_an_index_of_frames_that_is_text(root: Path) -> None:
    table = pq.read_table(data_file(root))
    at = table.schema.get_field_index("frame_index")
    text = table.set_column(at, "frame_index", pa.array(["0", "1", "2"]))
    pq.write_table(text, data_file(root))
    with pytest.raises(DataError, match=r"'frame_index' of file .* holds string"):
        read(root)


def test_terminal_escapes_in_a_name_stay_out_of_messages(root: Path) -> None:
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features["\x1b[2Jstate"] = features.pop("observation.state")
    edit(root, features=features)
    with pytest.raises(DataError) as caught:
        read(root)
    assert "\x1b" not in str(caught.value)
    assert "\\x1b[2Jstate" in str(caught.value)


def test_a_name_longer_than_messages_are(root: Path) -> None:
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features["a" * 5000] = features.pop("observation.state")
    edit(root, features=features)
    with pytest.raises(DataError, match="has a name of 5000 characters") as caught:
        read_folder(root)
    assert len(str(caught.value)) < 800


def test_names_of_numbers_longer_than_messages_are(root: Path) -> None:
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features["observation.state"]["names"] = ["x" * 100_000]
    edit(root, features=features)
    names = read_folder(root).feature("observation.state").names
    assert names == ("x" * 197 + "...",)


@pytest.mark.parametrize("shape", [[10**12], [2], [10**6, 10**6], [2**62] * 8])
def test_a_size_is_checked_against_the_file(root: Path, shape: list[int]) -> None:
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features["observation.state"]["shape"] = shape
    edit(root, features=features)
    folder = read_folder(root)
    with pytest.raises(DataError, match="holds 1 numbers per frame, but meta/info"):
        check_stored_sizes(folder, ["observation.state"])
    # A feature whose name begins with another's is one of its own.
    column = pa.array([[1.0, 2.0]] * 3)
    table = pq.read_table(data_file(root)).append_column("observation.state.2", column)
    pq.write_table(table, data_file(root))
    with pytest.raises(DataError, match="holds 1 numbers per frame"):
        check_stored_sizes(folder, ["observation.state"])


def test_a_shape_of_dimensions_without_end(root: Path) -> None:
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features["observation.state"]["shape"] = [2**62] * 9
    edit(root, features=features)
    with pytest.raises(DataError, match="has no proper dtype and shape"):
        read_folder(root)


def test_a_number_beyond_what_is_asked_for_is_located(root: Path) -> None:
    folder = read_folder(root)
    names = ["observation.state", "frame_index"]
    assert set(read_columns(folder, names, largest=2.5)) == set(names)
    with pytest.raises(DataError, match=r"beyond \+-2 in 1 of 3 frames, .* at frame 2"):
        read_columns(folder, names, largest=2)
    with pytest.raises(DataError, match=r"'frame_index' .* is beyond \+-1 in 1 of 3"):
        read_columns(folder, ["frame_index"], largest=1)


def test_a_folder_of_many_features_names_some_of_them(root: Path) -> None:
    features = json.loads((root / "meta/info.json").read_text())["features"]
    number = {"dtype": "float32", "shape": [1]}
    edit(root, features=features | {f"sensor_{i:05d}": number for i in range(5000)})
    folder = read_folder(root)
    with pytest.raises(DataError, match="and 4974 more; where one of them") as caught:
        folder.feature("torque")
    assert len(str(caught.value)) < 1500
