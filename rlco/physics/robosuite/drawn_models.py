"""A scene's model under each parameter set of a domain's sample.

Compiling a robot takes a third of a second, and its meshes 64 MB, so that a set is
compiled when it is first drawn, and only what differs from the domain's own model is
kept of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from rlco.errors import RlcoError
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.apply import checked
from rlco.physics.effects.corrected_model import CorrectedModel, PlainModel
from rlco.physics.mj.model_struct import ModelValues
from rlco.physics.spec.sample import Sample


@dataclass(frozen=True)
class DrawnModel:
    """What a parameter set makes of a scene.

    Attributes:
        values: Its model's values, as far as the domain's own model has others.
        corrected: The action of its effects beyond the model; its model is the
            domain's own.
    """

    values: ModelValues
    corrected: CorrectedModel


class DrawnModels:
    """The parameter sets of a sample, as models of one scene.

    Args:
        plain: The scene without effects.
        own: The scene with the domain's own effects.
        effects: These effects, with targets that are names in the model.
        sample: The parameter sets.

    Raises:
        EffectError: If a set has a number that its effect cannot have.
    """

    def __init__(
        self,
        plain: PlainModel,
        own: CorrectedModel,
        effects: Sequence[AppliedEffect],
        sample: Sample,
    ) -> None:
        self._plain, self._own = plain, own
        # All are checked now: training should not end at a set that it draws late.
        self._sets = [
            [
                checked(plain.model, effect, controlled=True)
                for effect in sample.drawn(row, effects)
            ]
            for row in range(len(sample))
        ]
        self._models: dict[int, DrawnModel] = {}

    def __len__(self) -> int:
        return len(self._sets)

    def __getitem__(self, row: int) -> DrawnModel:
        if row not in self._models:
            self._models[row] = self._compiled(row)
        return self._models[row]

    def _compiled(self, row: int) -> DrawnModel:
        own, found = self._own, self._plain.with_effects(self._sets[row])
        if (found.controller_model is None) != (own.controller_model is None):
            raise RlcoError(
                "a parameter set of the sample changes what the robot's controller "
                "does not know of, and the effects' own numbers do not (or the other "
                "way round); give both, or neither, a size."
            )
        return DrawnModel(
            ModelValues.of(found.model, own.model),
            replace(found, model=own.model, controller_model=own.controller_model),
        )
