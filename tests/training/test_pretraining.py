"""Encoders that learn positions from labelled scenes, and from simulated rows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from rlco import keys
from rlco.data import Augmentation
from rlco.losses import CoTrainingLoss, ImitationLoss
from rlco.physics.tasks.push_cube import TASK
from rlco.policies import GaussianPolicy
from rlco.policies.nets.positions import PositionHead
from rlco.training.options.stage_one_options import StageOneOptions
from rlco.training.pretraining import (
    PositionTerm,
    position_errors,
    pretrain,
    pretrained_head,
    tool_positions,
)

SHIFT = Augmentation(shift=0.03, brightness=0.0, contrast=0.0)


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)


class Plane:
    """A task whose scenes are a red square on grey, at x and y in [0, 1]."""

    state_names = ("tool.x", "tool.y")
    environment_state_names = ("square.x", "square.y")


def squares(count: int) -> TensorDict:
    images = torch.full((count, 3, 64, 64), 120, dtype=torch.uint8)
    place = torch.randint(8, 56, (count, 2))
    for one, (x, y) in zip(images, place.tolist(), strict=True):
        one[:, y - 4 : y + 4, x - 4 : x + 4] = torch.tensor(
            [230, 20, 20], dtype=torch.uint8
        )[:, None, None]
    rows = TensorDict(batch_size=[count])
    rows[keys.IMAGE] = images
    rows[keys.STATE] = torch.rand(count, 2)
    rows[keys.ENVIRONMENT_STATE] = place / 64
    return rows


def policy_of(kind: str) -> Any:
    image: Any = {"kind": kind, "size": (64, 64)}
    return GaussianPolicy(2, chunk=1, image=image, hidden=(8,))


@pytest.mark.thorough
@pytest.mark.parametrize(("augmentation", "passes"), [(None, 50), (SHIFT, 30)])
def test_positions_relative_to_the_tool_are_read_from_new_images(
    augmentation: Augmentation | None, passes: int
) -> None:
    policy, head = policy_of("dense"), PositionHead(128, 2, 2)
    others = {k: v.clone() for k, v in policy.network.state_dict().items()}
    scenes, held_out = squares(512), squares(64)
    positions = tool_positions(Plane, scenes)
    head.set_normalization(scenes[keys.STATE], positions)
    before = position_errors(Plane, policy, head, held_out).mean()
    pretrain(policy, head, scenes, positions, passes=passes, augmentation=augmentation)
    after = position_errors(Plane, policy, head, held_out).mean()
    # Squares are anywhere on a unit, and so is the tool; a pixel is a 64th.
    assert before > 0.2
    assert after < 1 / 64
    assert all(
        torch.equal(v, others[k]) for k, v in policy.network.state_dict().items()
    )


def test_the_term_of_simulated_rows_moves_the_encoder_and_reads_an_image_once() -> None:
    policy, head = policy_of("dense"), PositionHead(128, 2, 2)
    policy.encoder.reads_stored = True
    sim, real = squares(6), squares(6)
    for rows in (sim, real):
        rows[keys.CHUNK] = torch.zeros(6, 1, 7)
    loss = CoTrainingLoss(
        ImitationLoss(policy), ImitationLoss(policy), sim_coeff=0.5, real_coeff=0.5
    )
    term = PositionTerm(Plane, policy, head, coeff=2.0)
    once = TensorDict({"sim": sim.clone(), "real": real.clone()})
    position = term(once["sim"])
    reads: list[int] = []
    policy_image = policy.encoder.image
    hook = policy_image.register_forward_hook(lambda *_: reads.append(1))
    together = loss(once)
    hook.remove()
    expected = loss(TensorDict({"sim": sim, "real": real}))
    for name, value in expected.items():
        torch.testing.assert_close(together[name], value)
    torch.testing.assert_close(
        position,
        2.0
        * head.loss(
            policy_image(sim[keys.IMAGE]), sim[keys.STATE], tool_positions(Plane, sim)
        ),
    )
    # What the optimiser of Stage I follows: the encoder's weights inside the loss.
    position.backward()
    weights = {id(p) for p in loss.parameters()}
    for parameter in policy_image.parameters():
        assert id(parameter) in weights
        assert parameter.grad is not None
        assert float(parameter.grad.abs().sum()) > 0


@dataclass
class Folder:
    """What pretraining needs of a run."""

    path: Path


def scenes_drawn(
    seed: int, path: Path, monkeypatch: pytest.MonkeyPatch, *, scenes: int = 8
) -> list[TensorDict]:
    """Return the scenes that a run with a seed trains on, and is measured on."""
    drawn: list[TensorDict] = []

    def draw(task: object, count: int, *, seed: int, **_: object) -> TensorDict:
        torch.manual_seed(seed)
        drawn.append(squares(count))
        return drawn[-1]

    monkeypatch.setattr("rlco.data.labelled_scenes.labelled_scenes", draw)
    monkeypatch.setattr("rlco.training.pretraining.HELD_OUT", 8)
    options = StageOneOptions(
        seed=seed,
        image="dense",
        image_size=64,
        pretrain_scenes=scenes,
        pretrain_passes=1,
    )
    path.mkdir()
    run: Any = Folder(path)
    pretrained_head(options, run, policy_of("dense"), Plane, None)
    return drawn


def test_a_runs_seed_draws_its_scenes_and_others_to_measure_the_error_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, again, other, third = (
        scenes_drawn(seed, tmp_path / str(number), monkeypatch)
        for number, seed in enumerate((0, 0, 1, 2))
    )
    for first, second in zip(one, again, strict=True):
        assert torch.equal(first[keys.STATE], second[keys.STATE])
    starts = [rows[keys.STATE][0] for rows in (*one, *other, *third)]
    assert len(torch.unique(torch.stack(starts), dim=0)) == len(starts) == 6


@pytest.mark.parametrize(("scenes", "measured"), [(4, 4), (16, 8)])
def test_the_error_is_measured_on_no_more_scenes_than_are_trained_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scenes: int, measured: int
) -> None:
    drawn = scenes_drawn(0, tmp_path / "run", monkeypatch, scenes=scenes)
    assert [len(rows) for rows in drawn] == [scenes, measured]


def test_labels_are_those_of_the_task() -> None:
    rows = TensorDict(batch_size=[1])
    rows[keys.STATE] = torch.tensor([[0.5, 0.25, 9.0, 0, 0, 0, 0]])
    rows[keys.ENVIRONMENT_STATE] = torch.arange(12.0)[None]
    found = tool_positions(TASK, rows)[0]
    # x of the red cube, y of the red cube, ..., y of the blue mark.
    assert found[:2].tolist() == [-0.5, 0.75]
    assert found[-1].item() == 10.75
