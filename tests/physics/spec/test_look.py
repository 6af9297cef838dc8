"""Looks as data: read from files, drawn from ranges, refused where they are wrong."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from rlco.errors import DataError, RlcoError, UnknownNameError
from rlco.physics.spec.domain import (
    LOCKED,
    SIM,
    STAND_IN,
    Domain,
    make_domain,
    with_look,
    write_domain,
)
from rlco.physics.spec.look import Light, Look, Surface, View
from rlco.physics.spec.look_file import content_of_look, look_of
from rlco.physics.spec.look_ranges import LookRanges
from rlco.physics.spec.looks import LOOKS, RANDOM, make_look

WHOLE = Look(
    surfaces={"table": Surface("dark-wood", (0.5, 0.6, 0.7), 1.0, 0.3)},
    lights=(Light(position=(0.1, 0.2, 1.5)), Light(direction=(1.0, 0.0, -1.0))),
    headlight=Light(diffuse=(0.1, 0.2, 0.3)),
    cameras={"agentview": View((0.1, 0.0, 0.0), (0.0, 0.1, 0.0), 40.0, 0.8)},
    exposure=-0.5,
    white_balance=(1.2, 0.8),
    vignette=0.4,
    blur=0.01,
    noise=0.02,
)


def file_with(folder: Path, look: Any) -> Path:
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump({"effects": [], "look": look}))
    return path


@pytest.mark.parametrize("look", [WHOLE, STAND_IN.look, LOCKED.look, Look()])
def test_a_look_is_written_and_read_again(look: Look, tmp_path: Path) -> None:
    assert look_of(content_of_look(look), "here") == look
    write_domain(tmp_path / "robot.yaml", Domain("any", look=look))
    assert make_domain(tmp_path / "robot.yaml").look == look


def test_a_file_may_name_a_look(tmp_path: Path) -> None:
    assert make_domain(file_with(tmp_path, "locked")).look == LOCKED.look
    assert make_domain(file_with(tmp_path, None)).look == Look()
    write_domain(tmp_path / "wide.yaml", with_look(SIM, RANDOM))
    assert make_domain(tmp_path / "wide.yaml").look == LookRanges()


def test_ranges_of_ones_own_fit_in_no_file(tmp_path: Path) -> None:
    own = Domain("own", look=LookRanges(noise=(0.0, 0.1)))
    with pytest.raises(RlcoError, match="ranges of your own, which a file cannot hold"):
        write_domain(tmp_path / "own.yaml", own)


@pytest.mark.parametrize(
    ("look", "said"),
    [
        ("dusk", r"unknown look 'dusk'.*known: sim, stand_in, locked, random"),
        ({"vignete": 0.1}, r"unknown entry 'vignete'.*did you mean 'vignette'"),
        ({"vignette": 1.5}, r"vignette=1.5 of a look is out of range; give 0 to 1"),
        ({"noise": "much"}, r"noise in the look of .* is 'much'; give a number"),
        ({"white_balance": [1.0]}, r"white_balance in .* give 2 numbers"),
        ({"lights": {"diffuse": 1}}, r"lights in .* give a list of lights"),
        ({"lights": [{}] * 5}, r"a look has 5 lights; give at most 4"),
        ({"lights": [{"direction": [0, 0, 0]}]}, r"has no direction"),
        (
            {"cameras": {"agentview": {"crop": 0}}},
            r"crop=0.0 of a look is out of range",
        ),
        ({"surfaces": {"table": 3}}, r"table of surfaces .* is 3; give a map from"),
        (
            {"surfaces": {"robot": {"texture": "clay"}}},
            r"only table, table_legs, floor",
        ),
        (
            {"surfaces": {"objects": {"gloss": 0.5}}},
            r"gloss=0.5 of 'objects' cannot be",
        ),
        ([1], r"the look of effects file .* is \[1\]; give the name of a look"),
    ],
)
def test_what_is_no_look_is_refused(look: Any, said: str, tmp_path: Path) -> None:
    with pytest.raises(RlcoError, match=said):
        make_domain(file_with(tmp_path, look))


def test_a_wrong_file_is_an_error_of_data(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"the look of .*robot.yaml"):
        make_domain(file_with(tmp_path, {"blur": -1}))


def test_an_unknown_name_of_a_look_is_refused() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown look 'stand-in'.*'stand_in'"):
        make_look("stand-in")


def numbers_of(look: Look) -> dict[str, list[float]]:
    lamp, views = (look.lights or ())[0], look.cameras
    assert look.headlight is not None
    east, north, up = (-x for x in lamp.direction)
    return {
        "elevation": [float(np.arcsin(up))],
        "azimuth": [float(np.arctan2(north, east))],
        "headlight": list(look.headlight.diffuse),
        "saturation": [look.surfaces[part].saturation for part in ("objects", "robot")],
        "diffuse": list(lamp.diffuse),
        "ambient": list(lamp.ambient),
        "shift": [x for view in views.values() for x in view.shift],
        "turn": [x for view in views.values() for x in view.turn],
        "sensor_shift": [x for view in views.values() for x in view.sensor_shift],
        "exposure": [look.exposure],
        "white_balance": list(look.white_balance),
        "vignette": [look.vignette],
        "blur": [look.blur],
        "noise": [look.noise],
    }


def test_random_looks_fill_their_ranges_and_stay_inside() -> None:
    ranges = LookRanges()
    drawn = [ranges.draw(np.random.default_rng([7, k])) for k in range(200)]
    for name in numbers_of(drawn[0]):
        low, high = getattr(ranges, name)
        found = np.array([numbers_of(look)[name] for look in drawn])
        assert low <= found.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < found.max() <= high
        if name not in ("diffuse", "ambient", "headlight"):  # which are grey
            # Independent numbers of 200 looks: a correlation deviates by 0.07.
            apart = np.corrcoef(found.T) - np.eye(found.shape[1])
            assert np.abs(apart).max() < 0.35
    colours = np.array([[s.colour for s in look.surfaces.values()] for look in drawn])
    # Each colour is a brightness of 0.6 to 1, times a tint of 0.85 to 1 of its own.
    assert 0.6 * 0.85 <= colours.min() < 0.55
    assert 0.95 < colours.max() <= 1.0
    shades = colours.min(axis=-1) / colours.max(axis=-1)
    assert 0.85 <= shades.min() < 0.87
    for part, names in ranges.textures.items():
        assert {look.surfaces[part].texture for look in drawn} == set(names)
    lamps = np.array([(look.lights or ())[0].direction for look in drawn])
    assert (lamps[:, 2] < 0).all()  # from above, and from all sides
    assert abs(np.arctan2(lamps[:, 1], lamps[:, 0])).max() > 3.0
    for name, (low, high) in ranges.cameras.items():
        angles = [look.cameras[name].field_of_view or 0.0 for look in drawn]
        assert low <= min(angles) < max(angles) <= high


def test_a_look_is_drawn_by_its_seed_alone() -> None:
    ranges, seeds = LookRanges(), ([1, 2], [1, 2], [1, 3])
    one, same, other = (ranges.draw(np.random.default_rng(seed)) for seed in seeds)
    assert one == same != other


def test_random_looks_are_around_the_cameras_of_the_domain() -> None:
    at = View(
        shift=(0.1, 0.0, -0.4), turn=(0.2, 0.0, 0.0), crop=0.5, field_of_view=90.0
    )
    beside = View(shift=(0.0, 0.5, 0.0))
    own = Domain("own", look=Look(cameras={"agentview": at, "sideview": beside}))
    ranges = with_look(own, "random").look
    assert isinstance(ranges, LookRanges)
    for k in range(50):
        look = ranges.draw(np.random.default_rng(k))
        plain = LookRanges().draw(np.random.default_rng(k))
        # All that is not of this camera is as it would be around ``sim``.
        assert look.surfaces == plain.surfaces
        assert look.lights == plain.lights
        name = "robot0_eye_in_hand"
        assert look.cameras[name] == plain.cameras[name]
        one, around_sim = look.cameras["agentview"], plain.cameras["agentview"]
        assert one.shift == pytest.approx(np.add(around_sim.shift, at.shift))
        assert one.turn == pytest.approx(np.add(around_sim.turn, at.turn))
        assert one.sensor_shift == around_sim.sensor_shift
        assert one.crop == 0.5
        # 90 degrees, as 45 in ``sim`` are the middle of 41 to 49.
        assert one.field_of_view == pytest.approx(2.0 * around_sim.field_of_view)
        other = look.cameras["sideview"]
        assert other.field_of_view is None
        assert abs(other.shift[1] - 0.5) <= 0.02
        assert abs(other.shift[0]) <= 0.02


def test_ranges_that_say_around_what_keep_to_it() -> None:
    at = {"agentview": View(shift=(0.0, 0.0, -0.3))}
    own = Domain("own", look=Look(cameras={"agentview": View(shift=(0.0, 0.9, 0.0))}))
    assert with_look(own, LookRanges(around=at)).look == LookRanges(around=at)
    edge = Domain(
        "edge", look=Look(cameras={"agentview": View(shift=(0.99, 0.0, 0.0))})
    )
    with pytest.raises(RlcoError, match=r"shift=1\.01 of a look is out of range"):
        with_look(edge, "random")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"exposure": (1.0, -1.0)}, "give its least and its greatest value"),
        ({"noise": (0.0, 0.9)}, "noise=0.9 of a look is out of range"),
        ({"noise": (-0.1, 0.1)}, "noise=-0.1 of a look is out of range"),
        ({"textures": {"robot": ("clay",)}}, "texture='clay' of 'robot' cannot be"),
    ],
)
def test_ranges_that_hold_what_is_no_look_are_refused(given: Any, said: str) -> None:
    with pytest.raises(RlcoError, match=said):
        LookRanges(**given)


@pytest.mark.parametrize(
    "one",
    [
        {"exposure": 0.1},
        {"white_balance": (1.0, 1.1)},
        {"vignette": 0.1},
        {"blur": 0.01},
        {"noise": 0.01},
    ],
)
def test_what_lens_and_sensor_do_changes_frames_alone(one: Any) -> None:
    look = Look(**one)
    assert (look.changes_frames, look.changes_scene) == (True, False)


@pytest.mark.parametrize(
    "one",
    [
        {"surfaces": {"table": Surface()}},
        {"lights": ()},  # none, instead of those of ``sim``
        {"headlight": Light()},
        {"cameras": {"agentview": View()}},
    ],
)
def test_what_is_drawn_otherwise_changes_the_scene_alone(one: Any) -> None:
    look = Look(**one)
    assert (look.changes_frames, look.changes_scene) == (False, True)


def test_the_three_looks_differ_in_every_respect_that_they_give() -> None:
    sim, stand_in, locked = (LOOKS[name] for name in ("sim", "stand_in", "locked"))
    for one in fields(Look):
        values = [getattr(look, one.name) for look in (sim, stand_in, locked)]
        assert values[0] != values[1] != values[2] != values[0], one.name


def test_random_looks_have_no_texture_that_another_domains_look_adds() -> None:
    drawn = {name for names in LookRanges().textures.values() for name in names}
    for domain in (STAND_IN, LOCKED):
        assert isinstance(domain.look, Look)
        added = {part.texture for part in domain.look.surfaces.values()}
        assert not drawn & added - {None, "none"}
