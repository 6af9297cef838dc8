"""Ten numbers of a link: each is a link that could exist, and zero is the model's."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.apply import apply_to_spec
from rlco.physics.effects.link_parameters import LINK_NUMBERS, changed_link

XML = """
<mujoco><worldbody><body name="link"><joint axis="0 1 0"/>
<inertial pos="0.1 0.02 0" quat="0.9 0.1 0.3 0.2" mass="0.5"
diaginertia="0.001 0.002 0.0025"/></body></worldbody></mujoco>
"""


def changed(**numbers: float) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(XML)
    values = dict.fromkeys(LINK_NUMBERS, 0.0) | numbers
    apply_to_spec(spec, [AppliedEffect("link_parameters", "link", values)])
    return spec.compile()


def tensor(model: mujoco.MjModel) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return the inertia about the centre, in the body's axes."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[1])
    turn = turn.reshape(3, 3)
    return np.asarray(turn @ np.diag(model.body_inertia[1]) @ turn.T)


def test_zero_is_the_link_of_the_model() -> None:
    nominal, same = mujoco.MjModel.from_xml_string(XML), changed()
    assert same.body_mass[1] == nominal.body_mass[1]
    assert np.allclose(tensor(same), tensor(nominal), atol=1e-12)


def test_a_heavier_link_has_its_shape_and_a_multiple_of_mass_and_inertia() -> None:
    nominal, heavier = mujoco.MjModel.from_xml_string(XML), changed(mass=0.2)
    factor = np.exp(0.4)
    assert heavier.body_mass[1] == pytest.approx(0.5 * factor)
    assert np.allclose(heavier.body_ipos[1], nominal.body_ipos[1])
    assert np.allclose(tensor(heavier), factor * tensor(nominal), rtol=1e-9)


def test_a_shift_moves_the_centre_by_radii_of_gyration_and_keeps_the_rest() -> None:
    nominal, moved = mujoco.MjModel.from_xml_string(XML), changed(x=0.5)
    away = moved.body_ipos[1] - nominal.body_ipos[1]
    # The second moment along the first principal axis is (b + c - a) / 2.
    radius = np.sqrt((0.002 + 0.0025 - 0.001) / 2 / 0.5)
    assert np.linalg.norm(away) == pytest.approx(0.5 * radius)
    assert np.allclose(tensor(moved), tensor(nominal), rtol=1e-9)
    assert moved.body_mass[1] == pytest.approx(0.5)


def test_any_ten_numbers_are_a_link_that_could_exist() -> None:
    random = np.random.default_rng(0)
    start = 0.5, np.array([0.1, 0.02, 0.0]), np.array([0.001, 0.002, 0.0025])
    for values in random.normal(0.0, 0.7, (200, 10)):
        mass, _, inertia = changed_link(*start, values)
        a, b, c = np.linalg.eigvalsh(inertia)
        assert mass > 0.0
        assert a > 0.0
        assert a + b > c * (1.0 - 1e-9)
