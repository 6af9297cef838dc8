"""Effects on a model give the same compiled model wherever it is compiled."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from effect_cases import EFFECTS

from rlco.gap.compare.problem import Hypothesis
from rlco.gap.demos.replay.plants import Plants
from rlco.physics.effects.apply import apply_to_spec, library_effect
from rlco.physics.effects.names import in_model
from rlco.physics.mj.model_struct import array_fields
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.spec.domain import SIM, with_effects
from rlco.physics.tasks.push_cube import TASK

ON_MODEL = [e for e in EFFECTS.values() if library_effect(e.name).on_spec is not None]
_DRAWN = {"site_rgba", "geom_rgba"}  # robosuite hides sites when an episode starts
# What a search may leave out of a model: what is only drawn.
_DYNAMICS = ("body_mass", "body_inertia", "body_ipos", "jnt_stiffness", "qpos_spring")
_DYNAMICS += ("dof_damping", "dof_armature", "dof_frictionloss", "actuator_gainprm")
_DYNAMICS += ("actuator_biasprm", "actuator_forcerange")


@pytest.mark.slow
def test_search_and_both_backends_compile_the_same_model() -> None:
    env = Tabletop(TASK, with_effects(SIM, ON_MODEL))
    env.start(TASK.sample(np.random.default_rng(0), None))
    theirs = env.sim.model._model
    native = NativeStepper(TASK, SIM, num_envs=1, threads=1, effects=ON_MODEL).model
    xml = env.model.get_xml()
    for edit in env._xml_processors:
        xml = edit(xml)
    spec = mujoco.MjSpec.from_string(xml)
    effects = in_model(ON_MODEL, spec.copy().compile())
    apply_to_spec(spec, effects)
    alone = spec.compile()
    for name in sorted(set(array_fields()) - _DRAWN):
        np.testing.assert_array_equal(getattr(theirs, name), getattr(alone, name), name)
        np.testing.assert_array_equal(getattr(native, name), getattr(alone, name), name)
    replayed = Plants(TASK, SIM).plant(Hypothesis(tuple(effects))).model
    for name in _DYNAMICS:
        ours = getattr(replayed, name)
        np.testing.assert_array_equal(ours, getattr(alone, name), name)
    np.testing.assert_array_equal(replayed.opt.gravity, alone.opt.gravity)
    cube = (replayed.geom("red_cube_g0"), alone.geom("red_cube_g0"))
    for name in ("friction", "solref"):
        np.testing.assert_array_equal(*(getattr(geom, name) for geom in cube))
