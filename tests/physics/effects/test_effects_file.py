"""effects.yaml: what is written is read again, and what is damaged is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rlco.errors import DataError, RlcoError, UnknownNameError
from rlco.physics.effects import EFFECTS, AppliedEffect
from rlco.physics.effects.effects_file import EffectsFile, read_effects, write_effects

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
NAMES = st.text(st.characters(codec="utf-8", exclude_categories=["C"]), min_size=1)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    rows=st.lists(
        st.tuples(
            st.sampled_from(sorted(EFFECTS)),
            st.none() | NAMES,
            st.dictionaries(NAMES, NUMBERS, max_size=3),
        ),
        max_size=4,
    ),
    names=st.dictionaries(NAMES, NAMES, max_size=2),
)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory,
    rows: list[tuple[str, str | None, dict[str, float]]],
    names: dict[str, str],
) -> None:
    path = tmp_path_factory.mktemp("file") / "effects.yaml"
    effects = tuple(AppliedEffect(*row) for row in rows)
    write_effects(path, effects, names=names)
    assert read_effects(path) == EffectsFile(effects, names)


def test_the_file_is_one_that_people_read(tmp_path: Path) -> None:
    path = tmp_path / "effects.yaml"
    damping = AppliedEffect("viscous_damping", "joint4", {"damping": 8.0})
    units = {"viscous_damping": {"damping": "N m s/rad"}}
    write_effects(path, [damping], names={"joint4": "robot0_joint4"}, units=units)
    lines = [x for x in path.read_text().splitlines() if not x.startswith("#")]
    assert lines == [
        "version: 1",
        "effects:",
        "- name: viscous_damping",
        "  target: joint4",
        "  parameters: {damping: 8.0}",
        "  units: {damping: N m s/rad}",
        "names: {joint4: robot0_joint4}",
    ]


def test_units_may_differ_between_targets(tmp_path: Path) -> None:
    path = tmp_path / "effects.yaml"
    places = ("elbow", "rail", "wrist")
    effects = [AppliedEffect("viscous_damping", at, {"damping": 8.0}) for at in places]
    usual, rail = {"damping": "N m s/rad"}, {"damping": "N s/m"}
    units = {"viscous_damping": usual, "viscous_damping rail": rail}
    write_effects(path, effects, units=units)
    told = [x.strip() for x in path.read_text().splitlines() if "units" in x]
    turning = "units: {damping: N m s/rad}"
    assert told == [turning, "units: {damping: N s/m}", turning]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("effects: [", "is no YAML .* in line 1"),
        ("- name: x", "no list named 'effects'"),
        ("effects: {}", "no list named 'effects'"),
        ("version: 4\neffects: []", "version 4; versions 1 to 3 are read"),
        ("effects: []\nsensor: {}", "entry 'sensor' .did you mean 'sensors'"),
        ("effects: []\nsensors: [1]", "give a map from names to numbers"),
        ("effects: []\nnames: [a]", "give a map from names"),
        ("effects: [{name: backlash}]", "effect 1 of .* give its name, target and"),
        ("effects: [{name: backlash, parameters: {}, size: 1}]", "effect 1 of"),
        ("effects: [{name: backlash, target: 3, parameters: {}}]", "has the target 3"),
        ("effects: [{name: backlash, parameters: {width: wide}}]", "give numbers"),
        ("effects: [{name: backlash, parameters: {width: true}}]", "give numbers"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "effects.yaml"
    path.write_text(text)
    with pytest.raises(DataError, match=message) as caught:
        read_effects(path)
    assert "\n" not in str(caught.value)


def test_an_effect_that_no_library_has_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "effects.yaml"
    path.write_text("effects: [{name: backlas, target: j, parameters: {width: 1}}]")
    with pytest.raises(UnknownNameError, match="did you mean 'backlash'"):
        read_effects(path)
    with pytest.raises(RlcoError, match="is missing"):
        read_effects(tmp_path / "none.yaml")
