"""Image encoders that learn where things are before they imitate."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torch import Tensor

    from rlco.data import Augmentation, DemoReplayBuffer
    from rlco.policies import ChunkPolicy
    from rlco.policies.nets.positions import PositionHead
    from rlco.training.options.stage_one_options import StageOneOptions
    from rlco.training.run_protocols import TrainingRun

log = logging.getLogger("rlco.training")

#: Scenes beside those that are trained on, on which the error is measured: so many, or
#: as many as are trained on.
HELD_OUT = 400
#: Scenes of a step, and of a part when errors are measured.
BATCH, PART = 64, 256
#: Learning rate [1/step] after its rise over the first steps; it falls along a cosine.
LR, RISE = 1e-3, 100
WEIGHT_DECAY = 1e-4
#: Seeds of scenes are far from those of rollouts, evaluations and recordings.
SCENES_SEED = 700_000
#: The file of a run that holds what was pretrained.
PRETRAINED = "pretrained"


def tool_positions(task: Any, rows: TensorDictBase) -> Tensor:
    """Return the tool-relative positions [M, E] of rows that hold both states [m].

    Args:
        task: Names their dimensions.
        rows: Of demonstrations or labelled scenes, batch size [M].
    """
    from rlco import keys
    from rlco.policies.nets.positions import relative_positions, tool_axes

    axes = tool_axes(task.state_names, task.environment_state_names)
    return relative_positions(rows[keys.STATE], rows[keys.ENVIRONMENT_STATE], axes)


def pretrained_head(
    options: StageOneOptions,
    run: TrainingRun,
    policy: ChunkPolicy,
    task: Any,
    sim: DemoReplayBuffer | None,
) -> PositionHead | None:
    """Pretrain the policy's image encoder; return what reads positions from it.

    The result is kept in the run's folder: a resumed run loads it. All random numbers
    are apart from those of the run, which go on as if nothing had been drawn.

    Args:
        options: How many scenes, and how often each is learned from.
        run: Its folder keeps the encoder.
        policy: Its image encoders are trained.
        task: Whose scenes.
        sim: Simulated demonstrations, which normalise positions where there are no
            scenes.

    Returns:
        None where the options need none.
    """
    import torch

    from rlco import keys
    from rlco.policies.nets.positions import PositionHead
    from rlco.runs.state_files import load_state, save_state

    if not options.pretrain_scenes and not options.position_coeff:
        return None
    encoders = policy.encoder.image_encoders()
    with torch.random.fork_rng():
        torch.manual_seed(options.seed)
        head = PositionHead(
            sum(policy.encoder.image_sizes),
            len(task.state_names),
            len(task.environment_state_names),
        )
        path = run.path / PRETRAINED
        if path.exists():
            saved = load_state(path)
            head.load_state_dict(saved["head"])
            for one, weights in zip(encoders, saved["encoders"], strict=True):
                one.load_state_dict(weights)
            return head
        if options.pretrain_scenes:
            scenes, held_out = _scenes(options, policy, task)
        elif sim is not None:
            scenes = sim.frames()
        positions = tool_positions(task, scenes)
        head.set_normalization(scenes[keys.STATE], positions)
        if not options.pretrain_scenes:
            return head
        pretrain(
            policy,
            head,
            scenes,
            positions,
            passes=options.pretrain_passes,
            augmentation=_augmentation(options),
        )
        _report(task, policy, head, held_out)
        save_state(
            path,
            {
                "head": dict(head.state_dict()),
                "encoders": [dict(one.state_dict()) for one in encoders],
            },
        )
    return head


@dataclass
class PositionTerm:
    """An auxiliary loss of Stage I: where things are, in simulated rows alone.

    Attributes:
        task: Names the dimensions of both states.
        policy: Its image encoders are trained.
        head: Is trained, too.
        coeff: Weight of the loss.
    """

    task: Any
    policy: ChunkPolicy
    head: PositionHead
    coeff: float

    def __call__(self, rows: TensorDictBase) -> Tensor:
        """Return the weighted loss of simulated rows [B], which then hold features.

        An image is read once for this loss and the imitation loss, which follows.
        """
        from rlco import keys

        features = self.policy.encoder.image_features(rows)
        rows.set(keys.IMAGE_FEATURES, features)
        positions = tool_positions(self.task, rows)
        return self.coeff * self.head.loss(features, rows[keys.STATE], positions)


def _augmentation(options: StageOneOptions) -> Augmentation | None:
    from rlco.data import Augmentation

    shift = options.pretrain_shift
    if not shift:
        return None
    return Augmentation(shift=shift)


def _scenes(
    options: StageOneOptions, policy: ChunkPolicy, task: Any
) -> tuple[TensorDictBase, TensorDictBase]:
    """Draw labelled scenes to train on, and others to measure the error on."""
    from rlco.data.labelled_scenes import labelled_scenes

    side = options.image_size

    def draw(count: int, part: int) -> TensorDictBase:
        return labelled_scenes(
            task,
            count,
            seed=SCENES_SEED + 2 * options.seed + part,
            image_size=(side, side),
            cameras=policy.cameras,
            domain=options.pretrain_domain,
            renderer=policy.renderer,
            threads=options.threads,
        )

    scenes = options.pretrain_scenes
    return draw(scenes, 0), draw(min(HELD_OUT, scenes), 1)


def pretrain(
    policy: ChunkPolicy,
    head: PositionHead,
    scenes: TensorDictBase,
    positions: Tensor,
    *,
    passes: int,
    augmentation: Augmentation | None = None,
) -> None:
    """Train a policy's image encoders, and a head on them, to predict positions.

    An image that is shifted a little is the same scene: its label stays.

    Args:
        policy: Only its image encoders are trained.
        head: Reads positions from features.
        scenes: Labelled scenes [M], see `rlco.data.labelled_scenes`.
        positions: Their labels [M, E] [m].
        passes: How often each scene is learned from.
        augmentation: Changes images at each draw; None: they stay.

    Raises:
        NonFiniteError: The loss is NaN or infinite.
    """
    import torch

    from rlco import keys
    from rlco.finite import check_step, gradient_norm

    encoder = policy.encoder
    trained = [p for one in encoder.image_encoders() for p in one.parameters()]
    trained = [p for p in [*trained, *head.parameters()] if p.requires_grad]
    optimizer = torch.optim.AdamW(trained, lr=LR, weight_decay=WEIGHT_DECAY)
    steps = max(passes * len(scenes) // BATCH, 1)
    rise = min(RISE, steps)

    def rate(step: int) -> float:
        return min(1.0, (step + 1) / rise) * (1 + math.cos(math.pi * step / steps)) / 2

    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, rate)
    order = torch.randperm(len(scenes))
    at = 0
    for step in range(1, steps + 1):
        if at + BATCH > len(order):
            order, at = torch.randperm(len(scenes)), 0
        drawn = order[at : at + BATCH]
        at += BATCH
        rows = scenes.select(keys.STATE, *encoder.image_keys)[drawn]
        if augmentation is not None:
            for key in encoder.image_keys:
                rows.set(key, augmentation(rows[key]))
        features = encoder.image_features(rows)
        loss = head.loss(features, rows[keys.STATE], positions[drawn])
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        check_step(
            f"step {step} of pretraining",
            [("loss_position", loss)],
            [gradient_norm(trained)],
            {"policy": policy},
        )
        optimizer.step()
        schedule.step()


def position_errors(
    task: Any, policy: ChunkPolicy, head: PositionHead, rows: TensorDictBase
) -> Tensor:
    """Return the absolute errors of predicted positions [M, E] [m]."""
    import torch

    from rlco import keys

    with torch.no_grad():
        found = [
            head(policy.encoder.image_features(part), part[keys.STATE])
            for part in rows.split(PART)
        ]
    return (torch.cat(found) - tool_positions(task, rows)).abs()


def _report(
    task: Any, policy: ChunkPolicy, head: PositionHead, held_out: TensorDictBase
) -> None:
    """Log how far off positions are in scenes that were not trained on."""
    errors = 1e3 * position_errors(task, policy, head, held_out)
    worst = int(errors.mean(0).argmax())
    log.info(
        "positions from images: off by %.1f mm on average in %d new scenes, median "
        "%.1f mm; most of all %s, %.1f mm",
        float(errors.mean()),
        len(held_out),
        float(errors.median()),
        task.environment_state_names[worst],
        float(errors[:, worst].mean()),
    )


def with_features(policy: ChunkPolicy, demos: DemoReplayBuffer) -> DemoReplayBuffer:
    """Return demonstrations whose images were read once, by a fixed encoder.

    They hold ``("observation", "image_features")`` in place of images.

    Args:
        policy: Its images are fixed, see `rlco.policies.ChunkPolicy.fix_images`.
        demos: With images.
    """
    import torch
    from torchrl.data import LazyTensorStorage

    from rlco import keys
    from rlco.data import DemoReplayBuffer

    rows = demos.frames()
    with torch.no_grad():
        found = [policy.encoder.image_features(part) for part in rows.split(PART)]
    kept = [
        key
        for key in rows.keys(include_nested=True, leaves_only=True)
        if not keys.is_image(key) and key != keys.INSTRUCTION
    ]
    read = rows.select(*kept).set(keys.IMAGE_FEATURES, torch.cat(found))
    buffer = DemoReplayBuffer(demos.meta, LazyTensorStorage(len(read)))
    buffer.extend(read)
    return buffer
