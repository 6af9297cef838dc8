"""Worlds that differ equal models that were compiled apart."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from domain_cases import scaled
from stepping_cases import TASK, starts

from rlco.errors import RlcoError
from rlco.physics.effects import AppliedEffect
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.native.worlds import Worlds
from rlco.physics.spec.domain import SIM

ACTIONS = np.random.default_rng(0).uniform(-1, 1, (3, 5, 7))
ALL = np.arange(3)


def play(stepper: NativeStepper) -> list[np.ndarray[tuple[int], np.dtype[np.float64]]]:
    stepper.reset(starts(1) * stepper.num_envs)
    stepper.step(ACTIONS[: stepper.num_envs])
    return [data.qpos.copy() for data in stepper.data]


def worlds() -> NativeStepper:
    return NativeStepper(TASK, SIM, num_envs=3, threads=2)


@pytest.mark.slow
def test_patched_masses_and_frictions_equal_models_compiled_with_them() -> None:
    patched, plain = worlds(), worlds()
    model = patched.model
    scale = np.array([1.0, 1.7, 0.4])
    mass = model.body_mass * scale[:, None]
    inertia = model.body_inertia * scale[:, None, None]
    friction = model.geom_friction * np.array([1.0, 0.3, 2.0])[:, None, None]
    fields = {"body_mass": mass, "body_inertia": inertia, "geom_friction": friction}
    patched.randomise(ALL, fields)
    motions = play(patched)

    for number in range(3):
        one = NativeStepper(TASK, SIM, num_envs=1, threads=1)
        for name, value in fields.items():
            getattr(one.model, name)[:] = value[number]
        mujoco.mj_setConst(one.model, mujoco.MjData(one.model))
        one.reset(starts(1))
        one.step(ACTIONS[number : number + 1])
        np.testing.assert_array_equal(one.data[0].qpos, motions[number])
    # Copy 0 was patched with the numbers it had.
    np.testing.assert_array_equal(play(plain)[0], motions[0])
    assert np.abs(play(plain)[1] - motions[1]).max() > 1e-6


def test_a_patch_equals_mujocos_own_compiler() -> None:
    # A body of 2 kg on a slide joint with armature: MuJoCo's compiler derives
    # invweight0, M0 and the mean inertia from its mass, as does the patch.
    def compiled(mass: float) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(
            f"""<mujoco><worldbody><body name="a"><joint type="slide" armature=".1"/>
            <geom size=".1" mass="{mass}"/><body pos="0 0 1"><joint/>
            <geom size=".1" mass="1"/></body></body></worldbody></mujoco>"""
        )

    heavy, light = compiled(2.0), compiled(0.5)
    stepper = worlds()
    inner = Worlds(
        light,
        stepper.worlds.control,
        (np.ones(6), np.ones(6)),
        num_envs=2,
        threads=1,
    )
    fields = {"body_mass": heavy.body_mass, "body_inertia": heavy.body_inertia}
    inner.randomise(np.array([1]), fields)
    got = inner.model_of(1)
    for name in ("dof_invweight0", "body_invweight0", "dof_M0", "body_subtreemass"):
        np.testing.assert_allclose(getattr(got, name), getattr(heavy, name), atol=1e-12)
    assert inner.model_of(0).body_mass[1] == 0.5


@pytest.mark.slow
def test_stiffness_and_delay_equal_a_domain_that_has_them() -> None:
    stepper = worlds()
    stiff = stepper.worlds.memory.stiffness[0] * 0.6
    stepper.randomise([1], stiffness=stiff[None])
    stepper.randomise(np.array([1, 2]), command_delay=np.array([0, 2]))
    motions = play(stepper)

    late = AppliedEffect("command_delay", None, {"delay": 0.1})
    for number, domain in (
        (0, SIM),
        (1, scaled(controller_stiffness=0.6)),
        (2, replace(SIM, effects=(late,))),
    ):
        one = NativeStepper(TASK, domain, num_envs=1, threads=1)
        one.reset(starts(1))
        one.step(ACTIONS[number : number + 1])
        np.testing.assert_allclose(one.data[0].qpos, motions[number], rtol=0, atol=1e-9)


def test_models_take_memory_only_where_they_differ() -> None:
    stepper = worlds()
    addresses = stepper.worlds.memory.models.copy()
    assert (addresses == addresses[0]).all()
    stepper.randomise(np.array([2]), {"body_mass": stepper.model.body_mass * 2.0})
    assert (stepper.worlds.memory.models[:2] == addresses[0]).all()
    own = stepper.worlds._models[2].arrays
    # Of 64 MB: what was given and what follows from it.
    assert sum(array.nbytes for array in own.values()) < 100_000
    stepper.worlds.restore_models(ALL)
    assert (stepper.worlds.memory.models == addresses[0]).all()


def gains(stepper: NativeStepper) -> tuple[np.ndarray, np.ndarray]:
    memory = stepper.worlds.memory
    return memory.stiffness.copy(), memory.damping.copy()


def test_one_gain_a_copy_is_each_copys_on_all_axes() -> None:
    # Six worlds and six axes: not to be taken for one gain an axis.
    stepper = NativeStepper(TASK, SIM, num_envs=6, threads=1)
    stiff, damp = gains(stepper)
    given = np.linspace(50.0, 300.0, 6)
    stepper.randomise(np.arange(6), stiffness=given)
    for number in range(6):
        after = [gain[number] for gain in gains(stepper)]
        np.testing.assert_array_equal(after[0], np.full(6, given[number]))
        # Critically damped as before: damping goes with the root of stiffness.
        root = np.sqrt(given[number] / stiff[number])
        np.testing.assert_allclose(after[1], damp[number] * root)
    stepper.randomise(np.arange(6), stiffness=given[None])
    np.testing.assert_array_equal(gains(stepper)[0], np.tile(given, (6, 1)))
    stepper.randomise([4, 1], stiffness=[70.0, 90.0])
    assert gains(stepper)[0][[1, 4], 0].tolist() == [90.0, 70.0]


def test_damping_alone_changes_damping_alone_and_the_motion() -> None:
    stepper = worlds()
    plain = play(stepper)
    stiff, damp = gains(stepper)
    stepper.randomise([1], damping=3.0 * damp[:1])
    motions = play(stepper)
    after = gains(stepper)
    np.testing.assert_array_equal(after[0], stiff)
    np.testing.assert_array_equal(after[1], damp * [[1.0], [3.0], [1.0]])
    np.testing.assert_array_equal(motions[0], plain[0])
    # More damping: the arm, commanded elsewhere at every step, comes less far.
    home = starts(1)[0].joint_position
    way = [np.abs(qpos[:7] - home).max() for qpos in (plain[1], motions[1])]
    assert way[1] < 0.8 * way[0]
    # With stiffness given too, damping is what it is told, and no ratio.
    stepper.randomise([1], stiffness=100.0, damping=7.0)
    assert {gain[1, 0] for gain in gains(stepper)} == {100.0, 7.0}


def test_a_patch_taken_back_leaves_nothing_behind() -> None:
    stepper = worlds()
    before = play(stepper)
    model = stepper.model
    heavy = {"body_mass": model.body_mass * 2.0, "body_inertia": model.body_inertia * 2}
    stepper.randomise([1], heavy)
    assert np.abs(play(stepper)[1] - before[1]).max() > 1e-6
    stepper.randomise([1], {name: getattr(model, name) for name in heavy})
    np.testing.assert_array_equal(play(stepper)[1], before[1])


def test_one_copys_model_shows_nothing_of_anothers() -> None:
    stepper = worlds()
    model = stepper.model
    stepper.randomise([0], {"body_mass": model.body_mass * 2.0})
    stepper.randomise([2], {"geom_rgba": np.full(model.geom_rgba.shape, 0.5)})
    masses = [stepper.model_of(i).body_mass.copy() for i in (0, 2, 1)]
    np.testing.assert_array_equal(masses[0], 2.0 * model.body_mass)
    np.testing.assert_array_equal(masses[1:], [model.body_mass] * 2)
    means = [stepper.model_of(i).stat.meanmass for i in (0, 2, 1)]
    assert means[0] == pytest.approx(2.0 * means[1])
    assert means[1] == means[2] == model.stat.meanmass


@functools.cache
def refusing() -> NativeStepper:
    return worlds()


NAN = float("nan")


@pytest.mark.parametrize(
    ("which", "changes", "message"),
    [
        ([0, 99], {}, r"which=\[0, 99\] is not allowed; give indices from 0 to 2"),
        ([-1], {}, r"which=\[-1\] is not allowed; give indices from 0 to 2"),
        ([1, 1], {}, "from 0 to 2, each once"),
        ([0.5], {}, r"give indices of worlds, shape \(R,\)"),
        ([True, False, True], {}, r"give indices of worlds, shape \(R,\)"),
        (2, {}, r"which=2 is not allowed; give indices of worlds, shape \(R,\)"),
        (ALL, {"stiffness": -1.0}, "stiffness=-1.0 is not allowed; give more than 0"),
        (ALL, {"stiffness": 0.0}, "stiffness=0.0 is not allowed; give more than 0"),
        (ALL, {"stiffness": NAN}, "stiffness contains NaN or infinity"),
        (ALL, {"stiffness": "stiff"}, "stiffness='stiff' is not allowed; give an arr"),
        (ALL, {"stiffness": np.ones(6)}, r"shape \(6,\); .* \(3,\) for one per world"),
        (ALL, {"damping": -1.0}, "damping=-1.0 is not allowed; give 0 or more"),
        (ALL, {"damping": np.ones((6, 3))}, r"damping has shape \(6, 3\); .* \(3, 6\)"),
        (ALL, {"command_delay": -1}, "command_delay=-1 is not allowed; give 0 or more"),
        (ALL, {"command_delay": 0.5}, "command_delay=0.5 is not allowed; .* whole"),
        (ALL, {"command_delay": [1, 2]}, r"command_delay has shape \(2,\); .* \(3,\)"),
    ],
)
def test_what_is_refused_changes_nothing(
    which: Any, changes: dict[str, Any], message: str
) -> None:
    assert_refused(which, {"body_mass": "double"}, changes, message)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "body_mas",
            1.0,
            "unknown array of mjModel 'body_mas' .did you mean 'body_mass",
        ),
        ("body_mass", np.ones(2), r"body_mass has shape \(2,\); give"),
        ("body_mass", "heavy", "body_mass='heavy' is not allowed; give an array of"),
        ("body_mass", NAN, "body_mass contains NaN or infinity; give finite numbers"),
        ("body_mass", -1.0, "body_mass has negative values; give 0 or more"),
        ("body_mass", 0.0, "body_mass has zeros where the model has none"),
        ("geom_friction", -0.1, "geom_friction has negative values"),
        ("geom_rgba", 2.0, r"geom_rgba has values outside \[0, 1\]"),
        # What a kernel or MuJoCo has read, or would follow to other memory.
        ("body_parentid", 7, "body_parentid cannot differ between worlds"),
        ("jnt_type", 1, "jnt_type cannot differ between worlds"),
        (
            "actuator_ctrlrange",
            100.0,
            "actuator_ctrlrange cannot differ between worlds",
        ),
        ("geom_size", 0.1, "geom_size cannot differ between worlds"),
        # By which a renderer would read or divide wrongly.
        ("mat_texid", 99, "mat_texid has values that are none of the model's"),
        ("mat_texid", 0.5, "give whole numbers from -1 to 5"),
        ("light_type", 3, "light_type has values that are none .* from 0 to 2"),
        ("cam_fovy", 0.0, r"cam_fovy has values outside \(0, 180\)"),
        ("cam_intrinsic", 0.0, "cam_intrinsic has focal lengths of 0"),
        ("cam_sensorsize", -1.0, "cam_sensorsize has negative values"),
        ("headlight", np.ones(3), r"headlight has shape \(3,\); give \(3, 3\)"),
    ],
)
def test_patches_that_are_refused_change_nothing(
    name: str, value: Any, message: str
) -> None:
    assert_refused(ALL, {"geom_friction": "double", name: value}, {}, message)


def assert_refused(
    which: Any, fields: dict[str, Any], changes: dict[str, Any], message: str
) -> None:
    """Give sound changes and a wrong one; check that none of them is made."""
    stepper = refusing()
    memory = stepper.worlds.memory
    before = [array.copy() for array in memory]
    given = {}
    for name, value in fields.items():
        own = getattr(stepper.model, name, None)
        if isinstance(value, str) and value == "double":
            given[name] = 2.0 * own
        else:
            scalar = isinstance(value, float | int) and own is not None
            given[name] = np.full(own.shape, value) if scalar else value
    everything = {"damping": 5.0, "command_delay": 1, **changes}
    with pytest.raises(RlcoError, match=message) as caught:
        stepper.randomise(which, given, **everything)
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)
    assert stepper.worlds.memory is memory
    for array, old in zip(memory, before, strict=True):
        np.testing.assert_array_equal(array, old)
    assert not stepper.worlds._models


def test_a_number_of_threads_that_is_none_is_refused() -> None:
    wrong: list[Any] = [0, -3, 1.5]
    for threads in wrong:
        with pytest.raises(RlcoError, match=f"threads={threads} is not allowed"):
            NativeStepper(TASK, SIM, num_envs=1, threads=threads)
