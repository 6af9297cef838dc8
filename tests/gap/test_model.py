"""The slim model: the same motion, compiled in a moment."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from log_cases import ARM, SHARED, arm, urdf

from rlco.errors import RlcoError, UnknownNameError
from rlco.gap.logs.log import Array
from rlco.gap.model import load_model
from rlco.physics.effects import EFFECTS

CASES = sorted((SHARED / "gap_cases").glob("pub_*_*"))
# Each holds what slimming could break.
MODELS = {
    "inertia of geoms, in degrees": """<mujoco><compiler angle="degree" boundmass=".1"
      boundinertia=".002" balanceinertia="true"/><worldbody><body euler="10 20 30">
      <joint axis="0 1 0" range="-60 60" limited="true"/><geom type="capsule"
      fromto="0 0 0 .1 .2 .3" size=".02" contype="0" conaffinity="0"/>
      <body pos="0 0 .1"><joint axis="1 0 0" damping=".01"/><inertial pos="0 .1 0"
      euler="5 6 7" mass=".001" diaginertia="1e-6 2e-6 4e-6"/></body></body>
      </worldbody></mujoco>""",
    "a total mass": """<mujoco><compiler settotalmass="3"/><worldbody><body><joint
      axis="0 1 0"/><geom size=".1" pos=".2 0 0"/><body pos=".4 0 0"><joint
      axis="0 1 0"/><inertial pos=".1 0 0" mass="2" fullinertia="1 2 2 .1 .2 .3"/>
      </body></body></worldbody></mujoco>""",
    "contact beside images": """<mujoco><asset><texture name="t" type="2d"
      builtin="checker" width="8" height="8"/><material name="m" texture="t"/><mesh
      name="wedge" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/><mesh name="shown"
      vertex="0 0 0 .2 0 0 0 .2 0 0 0 .2"/></asset><worldbody><geom name="floor"
      type="plane" size="1 1 1" material="m"/><body pos="0 0 .3"><freejoint/><geom
      name="hit" type="mesh" mesh="wedge"/><geom type="mesh" mesh="shown" contype="0"
      conaffinity="0" material="m"/><site name="s"/></body></worldbody><sensor><touch
      site="s"/></sensor></mujoco>""",
    "a tendon round a post": """<mujoco><worldbody><geom name="post" type="cylinder"
      size=".05 .1" euler="90 0 0" contype="0" conaffinity="0"/><site name="a"
      pos="-.2 0 .1"/><body pos=".1 0 0"><joint axis="0 1 0"/><geom size=".03"
      pos=".2 0 0" contype="0" conaffinity="0"/><site name="b" pos=".2 0 0"/></body>
      </worldbody><tendon><spatial stiffness="40" springlength=".2"><site site="a"/>
      <geom geom="post"/><site site="b"/></spatial></tendon></mujoco>""",
    "a body in a fluid": """<mujoco><option density="900" viscosity=".1" wind="1 0 0"/>
      <worldbody><body><joint axis="0 1 0"/><geom type="ellipsoid" size=".1 .02 .05"
      pos=".2 0 0" contype="0" conaffinity="0" fluidshape="ellipsoid"/></body>
      </worldbody></mujoco>""",
    "an aligned free body": """<mujoco><compiler alignfree="true"/><worldbody><body
      pos="0 0 1"><joint type="free"/><geom type="box" size=".1 .2 .3" pos=".3 0 0"
      euler="20 0 0" contype="0" conaffinity="0"/></body></worldbody></mujoco>""",
    "a pair of geoms that else pass": """<mujoco><worldbody><geom name="floor"
      type="plane" size="1 1 1" contype="0" conaffinity="0"/><body pos="0 0 .2">
      <freejoint/><geom name="ball" size=".1" contype="0" conaffinity="0"/></body>
      </worldbody><contact><pair geom1="floor" geom2="ball"/></contact></mujoco>""",
    "links that the compiler fuses": """<mujoco><compiler fusestatic="true"
      discardvisual="true"/><worldbody><body pos="0 0 .3"><geom size=".03"/><body>
      <joint axis="0 1 0" range="-99 99"/><geom size=".03" pos=".2 0 0"/><body
      pos=".4 0 0"><geom size=".03"/><geom size=".05" contype="0" conaffinity="0"/>
      </body></body></body></worldbody></mujoco>""",
}


def rollout(model: mujoco.MjModel, steps: int = 400) -> Array:
    """Positions under commands that jump now and then, (steps, nq)."""
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    data.qvel[:] = 0.3 * rng.normal(size=model.nv)
    path = np.empty((steps, model.nq))
    for step in range(steps):
        if step % 80 == 0:
            data.ctrl[:] = rng.uniform(-0.5, 0.5, model.nu)
        mujoco.mj_step(model, data)
        path[step] = data.qpos
    return path


def check_same_motion(file: Path) -> None:
    full = mujoco.MjModel.from_xml_path(str(file))
    slim = load_model(file)
    expected = rollout(full)
    assert np.ptp(expected, axis=0).max() > 0.05
    np.testing.assert_allclose(rollout(slim.model), expected, rtol=0, atol=1e-10)
    again = slim.spec.copy().compile()
    np.testing.assert_array_equal(rollout(again), rollout(slim.model))


@pytest.mark.parametrize("name", MODELS)
def test_the_motion_is_the_same(tmp_path: Path, name: str) -> None:
    file = tmp_path / "model.xml"
    file.write_text(MODELS[name])
    check_same_motion(file)


@pytest.mark.skipif(not CASES, reason=f"{SHARED / 'gap_cases'} is not there")
@pytest.mark.parametrize("index", range(0, len(CASES), 3))
def test_the_motion_of_the_cases_is_the_same(index: int) -> None:
    check_same_motion(CASES[index] / "model.xml")


def test_the_motion_of_robosuites_panda_is_the_same() -> None:
    import robosuite

    robots = Path(robosuite.__file__).parent / "models" / "assets" / "robots"
    file = robots / "panda" / "robot.xml"
    check_same_motion(file)
    slim = load_model(file)
    # Of 58 meshes the 8 that can touch one another stay, and without contact none.
    assert (slim.model.ngeom, slim.model.nmesh) == (8, 8)


@pytest.mark.parametrize("grip", ["fixed", "prismatic"])
def test_the_motion_of_a_urdf_is_the_same(tmp_path: Path, grip: str) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(urdf(grip))
    check_same_motion(file)
    loaded = load_model(file)
    assert loaded.actuators == ()
    # A fixed tool is a link of its own, on which a payload can be held.
    links = [body.name for body in loaded.spec.bodies[1:]]
    assert links == ["base", "upper", "lower", "tool"]


def test_what_cannot_touch_is_gone_and_what_can_is_not(tmp_path: Path) -> None:
    slim = arm(tmp_path, MODELS["contact beside images"])
    names = {slim.model.geom(i).name for i in range(slim.model.ngeom)}
    assert names == {"floor", "hit"}
    assert (slim.model.nmesh, slim.model.nmat, slim.model.ntex) == (1, 0, 0)
    assert slim.model.nsensor == 0


def test_an_added_mass_is_not_scaled_with_the_total(tmp_path: Path) -> None:
    slim = arm(tmp_path, MODELS["a total mass"])
    spec = slim.spec.copy()
    last = slim.model.body(slim.model.nbody - 1).name
    EFFECTS["payload"].on_spec(spec, last, np.array([0.7, 0.0, 0.0, 0.1]))
    EFFECTS["link_inertia"].on_spec(spec, last, np.array([2.0]))
    changed = spec.compile()
    assert changed.body(last).mass[0] == pytest.approx(
        2 * slim.model.body(last).mass[0]
    )
    assert changed.body_mass.sum() == pytest.approx(
        slim.model.body_mass.sum() + slim.model.body(last).mass[0] + 0.7
    )


def test_nameless_elements_get_names_that_are_free(tmp_path: Path) -> None:
    xml = """<mujoco><worldbody><body name="body2"><joint name="joint2"/><geom
    size=".1"/><body><joint/><geom size=".1"/><body><joint/><geom size=".1"/></body>
    </body></body></worldbody><actuator><motor joint="joint2"/><motor joint="joint2"/>
    </actuator></mujoco>"""
    model = arm(tmp_path, xml)
    assert model.joints == ("joint2", "joint3", "joint4")
    assert model.actuators == ("joint2", "actuator2")
    assert [b.name for b in model.spec.bodies[1:]] == ["body2", "body3", "body4"]


def test_source_and_names_are_the_users_own(tmp_path: Path) -> None:
    model = arm(tmp_path)
    assert model.source == ARM
    assert model.path == tmp_path / "model.xml"
    assert (model.name, model.joints) == ("arm", ("shoulder", "elbow", "wrist"))
    unnamed = ARM.replace('model="arm"', "")
    assert arm(tmp_path, unnamed).name == "model"


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        (
            "<mujoco><worldbody><body><joint/></body></worldbody></mujoco>",
            "mass and inertia of moving bodies must be larger than mjMINVAL",
        ),
        ("<mujoco><worldbdy/></mujoco>", "unrecognized element; Element 'worldbdy'"),
        ("<mujoco><worldbody>", "XML parse error"),
        (
            "<mujoco><asset><mesh file='lost.stl'/></asset></mujoco>",
            "Error opening file 'lost.stl'",
        ),
    ],
)
def test_mujocos_own_words_are_kept(tmp_path: Path, xml: str, words: str) -> None:
    with pytest.raises(RlcoError, match="does not compile; MuJoCo says: ") as raised:
        arm(tmp_path, xml)
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_model_that_is_not_there() -> None:
    with pytest.raises(RlcoError, match=r"is not a file; give an MJCF file"):
        load_model("nowhere.xml")


def test_a_task_is_the_model_that_robosuite_steps() -> None:
    from rlco.physics.tasks.plain_robosuite import make_robosuite

    loaded = load_model("robosuite:push_cube")
    theirs = make_robosuite("push_cube").sim.model._model
    assert loaded.task == "push_cube"
    for field in ("body_mass", "body_inertia", "jnt_range", "dof_damping"):
        np.testing.assert_array_equal(
            getattr(loaded.model, field), getattr(theirs, field)
        )
    assert loaded.model.ngeom < theirs.ngeom


def test_a_task_that_is_misspelt() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'Lift'"):
        load_model("robosuite:Lft")
    told = r"unknown task 'push_cub' \(did you mean 'push_cube'\?\)"
    with pytest.raises(UnknownNameError, match=told) as raised:
        load_model("robosuite:push_cub")
    assert "Tabletop" not in str(raised.value)
