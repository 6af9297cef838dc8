"""Copies that differ equal models that were compiled apart."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from stepping_cases import TASK, starts

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.copies import Copies
from rlco.physics.domain import SIM, Domain
from rlco.physics.native import NativeStepper

ACTIONS = np.random.default_rng(0).uniform(-1, 1, (3, 5, 7))
ALL = np.arange(3)


def play(stepper: NativeStepper) -> list[np.ndarray[tuple[int], np.dtype[np.float64]]]:
    stepper.reset(starts(1) * stepper.num_envs)
    stepper.step(ACTIONS[: stepper.num_envs])
    return [data.qpos.copy() for data in stepper.data]


def copies() -> NativeStepper:
    return NativeStepper(TASK, SIM, num_envs=3, threads=2)


def test_patched_masses_and_frictions_equal_models_compiled_with_them() -> None:
    patched, plain = copies(), copies()
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
    stepper = copies()
    inner = Copies(
        light,
        stepper.copies.control,
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


def test_stiffness_and_delay_equal_a_domain_that_has_them() -> None:
    stepper = copies()
    stiff = stepper.copies.memory.stiffness[0] * 0.6
    stepper.randomise(np.array([1]), stiffness=stiff)
    stepper.randomise(np.array([1, 2]), command_delay=np.array([0, 2]))
    motions = play(stepper)

    for number, domain in (
        (0, SIM),
        (1, Domain("soft", stiffness_scale=0.6)),
        (2, replace(SIM, command_delay=2)),
    ):
        one = NativeStepper(TASK, domain, num_envs=1, threads=1)
        one.reset(starts(1))
        one.step(ACTIONS[number : number + 1])
        np.testing.assert_allclose(one.data[0].qpos, motions[number], rtol=0, atol=1e-9)


def test_models_take_memory_only_where_they_differ() -> None:
    stepper = copies()
    addresses = stepper.copies.memory.models.copy()
    assert (addresses == addresses[0]).all()
    stepper.randomise(np.array([2]), {"body_mass": stepper.model.body_mass * 2.0})
    assert (stepper.copies.memory.models[:2] == addresses[0]).all()
    own = stepper.copies._models[2].arrays
    # Of 64 MB: what was given and what follows from it.
    assert sum(array.nbytes for array in own.values()) < 100_000
    stepper.copies.restore_models(ALL)
    assert (stepper.copies.memory.models == addresses[0]).all()


def test_wrong_patches_are_refused() -> None:
    stepper = copies()
    with pytest.raises(UnknownNameError, match="did you mean 'body_mass'"):
        stepper.randomise(ALL, {"body_mas": np.ones(3)})
    with pytest.raises(RlcoError, match=r"body_mass has shape \(2,\); give"):
        stepper.randomise(ALL, {"body_mass": np.ones(2)})
    with pytest.raises(RlcoError, match="command_delay=-1 is not allowed"):
        stepper.randomise(ALL, command_delay=-1)
