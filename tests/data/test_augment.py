"""Images of demonstrations are changed as they are drawn, those of rollouts never."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, ReplayBuffer

from rlco.data import Augmentation, DemoWriter, SimRealReplayBuffer, load_demos
from rlco.errors import DataError
from rlco.keys import IMAGE

NONE = Augmentation(shift=0.0, brightness=0.0, contrast=0.0)


def noisy(rows: int, size: int = 64) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    shape = (rows, 3, size, size)
    return torch.randint(0, 256, shape, dtype=torch.uint8, generator=generator)


def seeded() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_without_strength_nothing_changes() -> None:
    images = noisy(4)
    assert torch.equal(NONE(images), images)


def test_a_shift_moves_all_of_a_picture_and_repeats_its_edge() -> None:
    images = noisy(200)
    moved = Augmentation(shift=0.03, brightness=0.0, contrast=0.0)(images, seeded())
    found = set()
    for before, after in zip(images, moved, strict=True):
        # 3 % of 64 are 2 pixels: the inner part is somewhere in the old image.
        inner = after[:, 2:-2, 2:-2]
        places = [
            (y, x)
            for y in range(5)
            for x in range(5)
            if torch.equal(before[:, y : y + 60, x : x + 60], inner)
        ]
        assert len(places) == 1
        found.add(places[0])
        if places[0][0] == 0:  # moved down by two: the first row comes three times
            assert torch.equal(after[:, 0], after[:, 1])
            assert torch.equal(after[:, 1], after[:, 2])
    assert len(found) == 25  # every shift is drawn, each way


def test_light_is_scaled_and_hues_stay() -> None:
    images = torch.tensor([100, 50, 20], dtype=torch.uint8)[:, None, None]
    images = images.expand(64, 3, 64, 64)
    bright = Augmentation(shift=0.0, brightness=0.5, contrast=0.0)(images, seeded())
    factors = bright[:, :, 0, 0] / torch.tensor([100.0, 50.0, 20.0])
    assert float(factors.min()) >= 0.48
    assert float(factors.max()) <= 1.52
    assert float(factors[:, 0].std()) > 0.2
    # All channels by one factor, to the rounding of a byte.
    assert float((factors - factors[:, :1]).abs().max()) < 0.03
    flat = Augmentation(shift=0.0, brightness=0.0, contrast=0.5)(images, seeded())
    grey = flat.float().mean((1, 2, 3))
    torch.testing.assert_close(grey, torch.full((64,), 170 / 3), atol=0.6, rtol=0)
    assert float(flat.float().std(0)[0].mean()) > 5


def test_the_same_generator_changes_alike_and_the_given_pictures_stay() -> None:
    images = noisy(8)
    kept = images.clone()
    first, second = (
        Augmentation()(images, seeded()),
        Augmentation()(images, seeded()),
    )
    assert torch.equal(first, second)
    assert torch.equal(images, kept)
    assert not torch.equal(first[0], images[0])


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames of noise, 64 x 64, and one number each."""
    root = tmp_path_factory.mktemp("seen") / "set"
    names = {"state_names": ["x"], "action_names": ["a"]}
    size = (64, 64)
    with DemoWriter(root, fps=20, camera="front", image_size=size, **names) as writer:
        for image in noisy(3).numpy():
            writer.add_frame(state=[0.0], action=[0.0], task="push", image=image)
        writer.save_episode()
    return root


def test_drawn_demonstrations_are_augmented_and_rollouts_are_not(seen: Path) -> None:
    real = load_demos(seen)
    real.augmentation = Augmentation()
    rollout = TensorDict({IMAGE: noisy(8), "id": torch.arange(8)}, [8])
    sim = ReplayBuffer(storage=LazyTensorStorage(8))
    buffer = SimRealReplayBuffer(sim, real, sim_ratio=0.5, batch_size=8)
    buffer.extend(rollout)
    buffer.seed(1)
    first, second = list(buffer)
    for batch in (first, second):
        # To the bit: PPO's ratios depend on it.
        assert torch.equal(batch["sim"][IMAGE], rollout[IMAGE][batch["sim", "id"]])
        frames = batch["real", "frame"]
        originals = real.frames()[IMAGE][frames]
        assert all(
            not torch.equal(one, other)
            for one, other in zip(batch["real"][IMAGE], originals, strict=True)
        )
    # An image that is drawn twice is changed twice.
    drawn = torch.cat([b["real"][IMAGE] for b in (first, second)])
    assert len(drawn.unique(dim=0)) == len(drawn) == 8  # of three frames
    assert torch.equal(real.frames()[IMAGE], noisy(3))
    buffer.seed(1)
    again = next(iter(buffer))
    assert torch.equal(again["real"][IMAGE], first["real"][IMAGE])


# -- Sizes ---------------------------------------------------------------------


def test_wide_pictures_are_cut_and_made_smaller(tmp_path: Path) -> None:
    # 128 x 192: red on the left fifth, blue in the middle 128, which alone is kept.
    wide = np.zeros((3, 128, 192), np.uint8)
    wide[0, :, :32] = 255
    wide[2, :64, 32:160] = 200
    names = {"state_names": ["x"], "action_names": ["a"]}
    with DemoWriter(
        tmp_path / "wide", fps=20, camera="c", image_size=(128, 192), **names
    ) as writer:
        writer.add_frame(state=[0.0], action=[0.0], task="push", image=wide)
        writer.save_episode()
    (image,) = load_demos(tmp_path / "wide", image_size=(64, 64)).frames()[IMAGE]
    assert image.shape == (3, 64, 64)
    assert image.dtype == torch.uint8
    assert not image[0].any()
    assert (image[2, :31] == 200).all()
    assert (image[2, 33:] == 0).all()
    whole = load_demos(tmp_path / "wide").frames()[IMAGE]
    assert torch.equal(whole[0], torch.from_numpy(wide))
    with pytest.raises(DataError, match=r"too small for image_size=\(224, 224\)"):
        load_demos(tmp_path / "wide", image_size=(224, 224))
