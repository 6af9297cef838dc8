"""LeRobot folder to replay buffer: keys, chunks, padding, instructions."""

from __future__ import annotations

import json
import logging
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torchrl.data.vla.schema import validate_vla_tensordict

from rlco.data import DemoWriter, load_demos
from rlco.data.demos import chunk_indices
from rlco.data.recorded_task import recorded_task
from rlco.errors import ConfigError, DataError, OutputExistsError, RlcoError
from rlco.files import sizes
from rlco.keys import (
    ACTION,
    CHUNK,
    ENVIRONMENT_STATE,
    IMAGE,
    INSTRUCTION,
    INSTRUCTION_ID,
    IS_PAD,
    STATE,
)
from rlco.lerobot_files import read_folder

REAL = Path(__file__).parents[2].parent / "shared" / "data" / "real" / "lerobot_g1"
TASKS = ("push red", "push blue")
LENGTHS = (3, 2)


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes; the action of frame t of episode e is 10 e + t, twice."""
    root = tmp_path_factory.mktemp("demos") / "set"
    with DemoWriter(
        root,
        fps=20,
        state_names=["x"],
        action_names=["a", "b"],
        environment_state_names=["cx", "cy", "cz"],
        robot_type="panda",
        camera="front",
        image_size=(4, 6),
    ) as writer:
        for episode, length in enumerate(LENGTHS):
            for t in range(length):
                value = 10 * episode + t
                writer.add_frame(
                    state=[value + 0.5],
                    action=[value, value],
                    environment_state=[value] * 3,
                    image=np.full((3, 4, 6), value, np.uint8),
                    task=TASKS[episode],
                )
            writer.save_episode()
    return root


def test_loading_says_nothing_of_storages(
    demos: Path, caplog: pytest.LogCaptureFixture
) -> None:
    torchrl = logging.getLogger("torchrl")
    torchrl.addHandler(caplog.handler)
    try:
        with caplog.at_level(logging.INFO, "torchrl"):
            load_demos(demos)
            assert not caplog.records
            # Later lines of TorchRL are left as they are.
            torchrl.info("Initialized LazyTensorStorage")
            assert len(caplog.records) == 1
    finally:
        torchrl.removeHandler(caplog.handler)


def test_rows_by_hand(demos: Path) -> None:
    buffer = load_demos(demos, chunk=3)
    rows = buffer.frames()
    assert len(buffer) == 5
    values = torch.tensor([0.0, 1.0, 2.0, 10.0, 11.0])
    torch.testing.assert_close(rows[STATE], values[:, None] + 0.5)
    torch.testing.assert_close(rows[ACTION], values[:, None].expand(5, 2))
    torch.testing.assert_close(rows[ENVIRONMENT_STATE], values[:, None].expand(5, 3))
    assert rows[IMAGE].dtype == torch.uint8
    assert rows[IMAGE].shape == (5, 3, 4, 6)
    assert (rows[IMAGE] == values[:, None, None, None]).all()
    # Three steps from each frame; past the end of its episode the last one repeats.
    chunks = [[0, 1, 2], [1, 2, 2], [2, 2, 2], [10, 11, 11], [11, 11, 11]]
    is_pad = [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 0, 1], [0, 1, 1]]
    assert rows[CHUNK][..., 0].tolist() == chunks
    assert rows[CHUNK].shape == (5, 3, 2)
    assert rows[IS_PAD].tolist() == [[bool(p) for p in row] for row in is_pad]
    assert rows["episode"].tolist() == [0, 0, 0, 1, 1]
    assert rows["frame"].tolist() == [0, 1, 2, 0, 1]
    assert rows[INSTRUCTION_ID].tolist() == [0, 0, 0, 1, 1]
    assert rows[INSTRUCTION].tolist() == [TASKS[0]] * 3 + [TASKS[1]] * 2
    assert validate_vla_tensordict(rows, raise_on_error=False) == []


def test_meta(demos: Path) -> None:
    meta = load_demos(demos, chunk=3).meta
    assert (meta.fps, meta.robot_type, meta.chunk) == (20.0, "panda", 3)
    assert meta.state_names == ("x",)
    assert meta.action_names == ("a", "b")
    assert meta.environment_state_names == ("cx", "cy", "cz")
    assert meta.instructions == TASKS
    assert meta.episode_lengths == LENGTHS
    assert meta.image_key == "observation.images.front"


def test_memory_map_equals_memory(demos: Path, tmp_path: Path) -> None:
    in_memory = load_demos(demos, chunk=2)
    mapped = load_demos(demos, chunk=2, memmap=tmp_path / "rows")
    assert any((tmp_path / "rows").rglob("*.memmap"))
    a, b = in_memory.frames(), mapped.frames()
    assert set(a.keys(True, True)) == set(b.keys(True, True))
    for key in a.exclude(INSTRUCTION).keys(True, True):
        assert torch.equal(a[key], b[key]), key
    for buffer in (in_memory, mapped):
        buffer.set_rng(torch.Generator().manual_seed(0))
    first, second = in_memory.sample(16), mapped.sample(16)
    assert torch.equal(first[CHUNK], second[CHUNK])
    assert first[INSTRUCTION].tolist() == second[INSTRUCTION].tolist()
    with pytest.raises(OutputExistsError):
        load_demos(demos, memmap=tmp_path / "rows")


def test_samples_are_copies_with_the_text_of_their_rows(demos: Path) -> None:
    buffer = load_demos(demos)
    batch = buffer.sample(64)
    expected = [TASKS[i] for i in batch[INSTRUCTION_ID].tolist()]
    assert set(expected) == set(TASKS)
    assert batch[INSTRUCTION].tolist() == expected
    # The text follows its rows through what training code does with a batch.
    assert batch[10:20][INSTRUCTION].tolist() == expected[10:20]
    assert batch.reshape(8, 8)[3, 5][INSTRUCTION].tolist() == expected[29]
    joined = torch.cat([batch[:2], batch[5:6]]).clone().to("cpu")
    assert joined[INSTRUCTION].tolist() == [*expected[:2], expected[5]]
    batch[ACTION].zero_()
    assert buffer.frames()[ACTION].sum() == 2 * (0 + 1 + 2 + 10 + 11)


def test_torchrls_vla_modules_read_the_text(demos: Path) -> None:
    from torchrl.modules.vla import TinyVLA

    policy = TinyVLA(action_dim=2, chunk_size=2, action_head="continuous")
    batch = load_demos(demos, chunk=2).sample(3)
    policy(batch)
    assert batch[CHUNK].shape == (3, 2, 2)


def test_given_instructions_fix_the_ids(demos: Path) -> None:
    known = ("open drawer", "push blue", "push red")
    buffer = load_demos(demos, instructions=known)
    assert buffer.frames()[INSTRUCTION_ID].tolist() == [2, 2, 2, 1, 1]
    assert buffer.meta.instructions == known
    with pytest.raises(DataError, match=r"'push blue' \(did you mean 'push blau'\?\)"):
        load_demos(demos, instructions=("push red", "push blau"))
    # An instruction that no loaded frame carries is no reason to refuse.
    load_demos(demos, episodes=[0], instructions=("push red",))


def test_ids_do_not_depend_on_the_episodes_selected(demos: Path) -> None:
    rows = load_demos(demos, episodes=[1]).frames()
    assert rows[INSTRUCTION_ID].tolist() == [1, 1]
    assert rows["episode"].tolist() == [1, 1]
    assert (rows[IMAGE][:, 0, 0, 0]).tolist() == [10, 11]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"action_dim": 7}, "'action' .* has 2 numbers, but 7 are expected"),
        ({"state_dim": 2}, "'observation.state' .* has 1 number, but 2"),
        ({"environment_dim": 2}, "environment_state' .* has 3 numbers, but 2"),
        ({"image_key": "front"}, "no feature 'front'"),
        ({"image_key": "action"}, "'action' .* is not a camera"),
        (
            {"rename": {"action": "actions"}},
            r"no feature 'action' any more: rename gave",
        ),
    ],
)
def test_data_that_do_not_fit(
    demos: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(DataError, match=message):
        load_demos(demos, **options)


def test_environment_state_may_be_demanded_and_may_be_absent(demos: Path) -> None:
    away = {"observation.environment_state": "cube"}
    rows = load_demos(demos, rename=away).frames()
    assert ENVIRONMENT_STATE not in rows.keys(True)
    with pytest.raises(DataError, match=r"no feature 'observation.environment_state'"):
        load_demos(demos, rename=away, environment_dim=3)


def test_pictures_can_be_left_out(demos: Path) -> None:
    buffer = load_demos(demos, image_key=False)
    assert IMAGE not in buffer.frames().keys(True)
    assert buffer.meta.image_key is None


def test_chunk_must_be_positive(demos: Path) -> None:
    with pytest.raises(ConfigError, match="chunk=0"):
        load_demos(demos, chunk=0)


def test_a_size_of_images_has_two_numbers(demos: Path) -> None:
    recipes: Any = 64  # one number, as their option takes it
    with pytest.raises(RlcoError, match=r"image_size=64 .* give \(height, width\)"):
        load_demos(demos, image_size=recipes)


@given(
    lengths=st.lists(st.integers(1, 12), min_size=1, max_size=6),
    chunk=st.integers(1, 15),
)
def test_chunks_stay_in_their_episode(lengths: list[int], chunk: int) -> None:
    index, is_pad = chunk_indices(lengths, chunk)
    episode = torch.arange(len(lengths)).repeat_interleave(torch.tensor(lengths))
    assert (episode[index] == episode[:, None]).all()
    # A frame with r frames left in its episode (itself included) has r real steps.
    left = torch.cat([torch.arange(n, 0, -1) for n in lengths])
    assert torch.equal((~is_pad).sum(1), left.clamp(max=chunk))
    steps = torch.arange(len(episode))[:, None] + torch.arange(chunk)
    assert torch.equal(index[~is_pad], steps[~is_pad])


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real data set at {REAL}")
def test_real_data_set_loads_without_its_missing_videos() -> None:
    with pytest.raises(DataError, match="image_key=False"):
        load_demos(REAL, episodes=range(2))
    buffer = load_demos(REAL, episodes=range(2), chunk=8, image_key=False)
    assert len(buffer) == 479 + 393
    assert buffer.sample(4)[CHUNK].shape == (4, 8, 26)
    assert buffer.meta.action_names[0] == "kLeftShoulderPitch"
    assert buffer.meta.instructions == ("Pick up the yellow bottle on the table.",)


def test_what_does_not_fit_into_memory_is_refused_before_it_is_read(
    demos: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Five frames of 72 bytes are 360; a step of a chunk is 2 actions of 4 bytes, two
    # indices of 8 and a flag: 25 bytes, so chunks of two of five frames take 250.
    monkeypatch.setattr(sizes, "_memory", lambda: 2 * 359)
    with pytest.raises(DataError, match=r"the images of the 5 frames .* memmap="):
        load_demos(demos, chunk=2)
    load_demos(demos, chunk=2, image_key=False)
    load_demos(demos, chunk=2, image_size=(4, 4))  # 240 bytes
    with pytest.raises(DataError, match=r"chunks of 3 steps of the 5 frames"):
        load_demos(demos, chunk=3, image_key=False)  # 375 bytes
    monkeypatch.setattr(sizes, "_memory", lambda: 2 * 360)
    load_demos(demos, chunk=2)


def test_a_memory_map_holds_what_memory_does_not(
    demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Enough for all chunks, 250 bytes, and one episode's images, 216; not for all 360.
    monkeypatch.setattr(sizes, "_memory", lambda: 2 * 251)
    mapped = load_demos(demos, chunk=2, memmap=tmp_path / "rows")
    assert mapped.frames()[IMAGE][:, 0, 0, 0].tolist() == [0, 1, 2, 10, 11]


# -- Numbers that no training can take -------------------------------------------------


def change(root: Path, name: str, **entries: Any) -> None:
    info = json.loads((root / "meta" / "info.json").read_text())
    info["features"][name] |= entries
    (root / "meta" / "info.json").write_text(json.dumps(info))


@pytest.mark.parametrize("size", [10**9, 2**62])
def test_a_declared_size_takes_no_memory(
    demos: Path, tmp_path: Path, size: int
) -> None:
    shutil.copytree(demos, tmp_path / "set")
    change(tmp_path / "set", "action", shape=[size])
    message = f"'action' .* holds 2 numbers per frame, but meta/info.json says {size}"
    with pytest.raises(DataError, match=message):
        load_demos(tmp_path / "set")
    with pytest.raises(DataError, match=message):
        recorded_task({"real_demos": read_folder(tmp_path / "set")})


@pytest.mark.parametrize("value", [1e38, -1e300])
def test_a_number_of_which_float32_has_no_square(
    demos: Path, tmp_path: Path, value: float
) -> None:
    shutil.copytree(demos, tmp_path / "set")
    (file,) = (tmp_path / "set" / "data").rglob("*.parquet")
    table = pq.read_table(file)
    actions = [[0.0, value if row == 3 else 1.0] for row in range(table.num_rows)]
    place = table.schema.get_field_index("action")
    pq.write_table(table.set_column(place, "action", pa.array(actions)), file)
    with pytest.raises(
        DataError, match=r"'action' \(b\) .* 1 of 5 frames, first in epi"
    ):
        load_demos(tmp_path / "set")
