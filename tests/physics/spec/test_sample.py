"""Parameter sets in a domain's file, of which any may be damaged or made up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from rlco.errors import DataError
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.effects_file import write_effects
from rlco.physics.spec.domain import SIM, Domain, drawing, read_domain, write_domain
from rlco.physics.spec.sample import MOST_ROWS, Sample

FRICTION = AppliedEffect("coulomb_friction", "joint4", {"frictionloss": 0.5})
DELAY = AppliedEffect("command_delay", None, {"delay": 0.05})
TABLE = AppliedEffect("scene_friction", None, {"factor": 0.7})
SAMPLE = Sample(((1, "frictionloss"), (2, "delay")), ((0.4, 0.04), (0.6, 0.07)))
FOUND = Domain("found", (TABLE, FRICTION, DELAY), sample=SAMPLE)


def test_a_file_keeps_its_parameter_sets(tmp_path: Path) -> None:
    path = tmp_path / "found.yaml"
    write_domain(path, FOUND)
    assert read_domain(path) == FOUND
    assert drawing(FOUND, None).sample is None


def test_a_set_replaces_the_numbers_of_its_effects_alone() -> None:
    assert SAMPLE.drawn(1, FOUND.effects) == (
        TABLE,
        AppliedEffect("coulomb_friction", "joint4", {"frictionloss": 0.6}),
        AppliedEffect("command_delay", None, {"delay": 0.07}),
    )
    # What a task reads while it is built is not among the effects of its model.
    assert FOUND.model_sample is not None
    assert FOUND.model_sample.drawn(0, FOUND.model_effects)[0].parameters == {
        "frictionloss": 0.4
    }


def test_a_file_without_a_sample_is_what_it_was_before(tmp_path: Path) -> None:
    path = tmp_path / "found.yaml"
    write_effects(path, [FRICTION])
    text = path.read_text()
    assert "sample" not in text
    assert yaml.safe_load(text)["version"] == 1
    assert read_domain(path) == Domain("found", (FRICTION,))


COLUMN = {
    "effect": 2,
    "name": "coulomb_friction",
    "target": "joint4",
    "parameter": "frictionloss",
}
DAMAGED: dict[str, tuple[Any, str]] = {
    "no map": ([1], "give a map with columns and rows"),
    "empty": ({}, "lacks 'columns'"),
    "no rows": ({"columns": [COLUMN], "rows": []}, "has 0 rows; give 1 to 10000"),
    "endless": (
        {"columns": [COLUMN], "rows": [[0.1]] * (MOST_ROWS + 1)},
        "has 10001 rows",
    ),
    "ragged": ({"columns": [COLUMN], "rows": [[0.1], [0.1, 0.2]]}, "row 2 of the"),
    "nan": ({"columns": [COLUMN], "rows": [[float("nan")]]}, "give a finite number"),
    "text": ({"columns": [COLUMN], "rows": [["1"]]}, "give a finite number"),
    "twice": ({"columns": [COLUMN] * 2, "rows": [[1.0, 2.0]]}, "a parameter twice"),
    "other effect": (
        {"columns": [{**COLUMN, "effect": 3}], "rows": [[1.0]]},
        "which the file's effect 3 has not",
    ),
    "other target": (
        {"columns": [{**COLUMN, "target": "joint5"}], "rows": [[1.0]]},
        "which the file's effect 2 has not",
    ),
    "no effect": (
        {"columns": [{**COLUMN, "effect": 9}], "rows": [[1.0]]},
        "which the file's effect 9 has not",
    ),
    "other parameter": (
        {"columns": [{**COLUMN, "parameter": "size"}], "rows": [[1.0]]},
        "a column for 'size'",
    ),
    "of the task": (
        {
            "columns": [{"effect": 1, "name": "scene_friction", "parameter": "factor"}],
            "rows": [[1.0]],
        },
        "reads only while it is built",
    ),
    "unknown": ({"columns": [COLUMN], "rows": [[1.0]], "weights": [1]}, "'weights'"),
}


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_damaged_sample_is_refused_in_one_sentence(tmp_path: Path, kind: str) -> None:
    content, said = DAMAGED[kind]
    path = tmp_path / "found.yaml"
    write_domain(path, FOUND)
    file = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({**file, "sample": content}))
    with pytest.raises(DataError, match=said) as refusal:
        read_domain(path)
    assert str(refusal.value).count("\n") == 0


def test_a_domain_of_rlco_has_nothing_to_draw_from() -> None:
    assert SIM.sample is None
