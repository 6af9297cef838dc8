"""Mending: a short change of the user's own file, and the model that it gives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from log_cases import urdf

from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.verdict import Gap, NamedEffect, Value, Verdict
from rlco.gap.correct.corrected_files import (
    corrected_xml,
    with_notes,
    write_corrected,
)
from rlco.gap.correct.xml_text import parse
from rlco.gap.model import LoadedModel, load_model
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.apply import apply_to_spec
from rlco.physics.effects.effects_file import read_effects
from rlco.physics.spec.domain import read_domain

# As people write them: in degrees, with classes, comments, and what has no name.
ARM = """\
<mujoco model="arm">
  <!-- ours -->
  <default>
    <joint damping="0.5" limited="true" range="-90 90"/>
    <position kp="30"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body name="upper"
          pos="0 0 .1">
      <inertial pos="0 0 .2" mass="1.5" fullinertia=".1 .1 .02 0 0 0"/>
      <joint name='shoulder' axis="0 1 0" springref="20" stiffness="1"/>
      <body name="lower" pos="0 0 .4">
        <joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" size=".02" fromto="0 0 0 0 0 .3" density="500"/>
        <frame pos="0 0 .3">
          <body name="hand"><joint axis="0 0 1"/><geom size=".03" mass=".2"/></body>
        </frame>
      </body>
    </body>
    <body name="cube" pos=".5 0 .1"><freejoint/><geom size=".02"/></body>
  </worldbody>
  <actuator>
    <position joint="shoulder" name="shoulder" forcerange="-40 40"/>
    <motor joint="elbow" gear="2"/>
  </actuator>
</mujoco>
"""
OF_EACH_KIND = {
    "viscous_damping": ("shoulder", {"damping": 2.0}),
    "coulomb_friction": ("elbow", {"frictionloss": 0.25}),
    "stribeck_friction": ("elbow", {"static": 0.25, "speed": 0.1}),
    "armature": ("elbow", {"armature": 0.0125}),
    "joint_stiffness": ("shoulder", {"stiffness": 3.0, "rest": 0.5}),
    "payload": ("hand", {"mass": 0.4, "x": 0.0, "y": 0.01, "z": 0.1}),
    "link_inertia": ("upper", {"factor": 1.2}),
    "actuator_gain": ("shoulder", {"factor": 1.3}),
    "torque_limit": ("elbow", {"limit": 5.0}),
    "torque_bias": ("shoulder", {"torque": -0.7}),
    "joint_compliance": ("shoulder", {"compliance": 0.002}),
    "gravity_tilt": (None, {"roll": 0.1, "pitch": -0.05}),
    "contact_friction": (None, {"friction": 0.3}),
    "contact_stiffness": (None, {"time_constant": 0.04}),
    "object_mass": ("cube", {"factor": 2.5}),
}


def load(folder: Path, xml: str = ARM) -> LoadedModel:
    path = folder / "arm.xml"
    path.write_text(xml)
    return load_model(path)


def verdict(*effects: AppliedEffect) -> Verdict:
    gap = Gap("rad", 1.0, 1.0, 0.1, 0.1, 0.1)
    hypothesis = Hypothesis(tuple(effects))
    return Verdict(True, "named", (), gap, {}, (), 1.0, hypothesis, (0,), (1,))


def changed_lines(diff: str) -> tuple[list[str], list[str]]:
    lines = [x for x in diff.splitlines() if not x.startswith(("---", "+++", "@@"))]
    removed = [x[1:].strip() for x in lines if x.startswith("-")]
    added = [x[1:].strip() for x in lines if x.startswith("+")]
    return removed, added


@pytest.mark.parametrize("name", OF_EACH_KIND)
def test_the_corrected_file_is_the_model_with_the_effect_in_it(
    name: str, tmp_path: Path
) -> None:
    loaded = load(tmp_path)
    effect = AppliedEffect(name, *OF_EACH_KIND[name])
    write_corrected(loaded, verdict(effect), tmp_path)
    text = (tmp_path / "model.xml").read_text()
    corrected = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))

    # Against the slim model that the search has changed, which has other geoms.
    spec = loaded.spec.copy()
    apply_to_spec(spec, [effect])
    searched = spec.compile()
    for field in (
        "dof_damping",
        "dof_frictionloss",
        "dof_armature",
        "jnt_stiffness",
        "qpos_spring",
        "body_mass",
        "body_subtreemass",
        "actuator_gainprm",
        "actuator_biasprm",
        "actuator_forcerange",
    ):
        np.testing.assert_allclose(
            getattr(corrected, field),
            getattr(searched, field),
            rtol=1e-8,
            err_msg=field,
        )
    np.testing.assert_allclose(corrected.opt.gravity, searched.opt.gravity)
    touching = [g for g in range(corrected.ngeom) if corrected.geom_contype[g]]
    assert len(touching) == searched.ngeom
    for field in ("geom_friction", "geom_solref"):
        np.testing.assert_allclose(
            getattr(corrected, field)[touching], getattr(searched, field)
        )
    assert not np.array_equal(_numbers(corrected), _numbers(loaded.model)) or (
        corrected.nbody + corrected.njnt > loaded.model.nbody + loaded.model.njnt
    )
    # The author's comment and quotes are still there: the text was edited.
    assert "<!-- ours -->" in text
    assert "name='shoulder'" in text


def test_effects_yaml_holds_the_sets_of_what_was_named(tmp_path: Path) -> None:
    loaded = load(tmp_path)
    calibrated = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.1})
    friction = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.25})
    pull = AppliedEffect("joint_stiffness", "shoulder", {"stiffness": 3.0, "rest": 0.5})
    named = tuple(
        NamedEffect(
            one.name,
            one.target,
            {k: Value(v, v - 0.1, v + 0.1, "") for k, v in one.parameters.items()},
        )
        for one in (friction, pull)
    )
    sets = np.array([[0.2, 3.1, 1 / 3], [0.3, 2.9, 0.5]])
    # A calibration comes first, here of the same friction.
    found = replace(verdict(calibrated, friction, pull), effects=named, sample=sets)
    write_corrected(loaded, found, tmp_path)
    domain = read_domain(tmp_path / "effects.yaml")
    assert domain.sample is not None
    assert domain.sample.drawn(0, domain.effects) == (
        calibrated,
        replace(friction, parameters={"frictionloss": 0.2}),
        replace(pull, parameters={"stiffness": 3.1, "rest": 0.333333}),
    )


def _numbers(model: mujoco.MjModel) -> np.ndarray:
    parts = (
        model.dof_damping,
        model.dof_frictionloss,
        model.dof_armature,
        model.jnt_stiffness,
        model.body_mass,
        model.actuator_gainprm,
        model.actuator_biasprm,
        model.actuator_forcerange,
        model.opt.gravity,
        model.geom_friction,
        model.geom_solref,
    )
    return np.concatenate([np.ravel(part) for part in parts])


def test_the_difference_is_one_line_where_a_number_changes(tmp_path: Path) -> None:
    loaded = load(tmp_path)
    damping = AppliedEffect("viscous_damping", "shoulder", {"damping": 2.0})
    write_corrected(loaded, verdict(damping), tmp_path)
    removed, added = changed_lines((tmp_path / "model.diff").read_text())
    assert removed == [
        """<joint name='shoulder' axis="0 1 0" springref="20" stiffness="1"/>"""
    ]
    assert added == [
        """<joint name='shoulder' axis="0 1 0" springref="20" stiffness="1" """
        """damping="2.5"/>"""
    ]
    assert read_effects(tmp_path / "effects.yaml").effects == (damping,)


def test_several_effects_of_one_element_share_its_line(tmp_path: Path) -> None:
    loaded = load(tmp_path)
    effects = [
        AppliedEffect("actuator_gain", "elbow", {"factor": 0.5}),
        AppliedEffect("torque_bias", "elbow", {"torque": 1.0}),
        AppliedEffect("torque_limit", "elbow", {"limit": 3.0}),
    ]
    write_corrected(loaded, verdict(*effects), tmp_path)
    removed, added = changed_lines((tmp_path / "model.diff").read_text())
    assert removed == ['<motor joint="elbow" gear="2"/>']
    # A motor cannot say a bias. 1 N m at the joint is half of it before the gear.
    assert added == [
        '<general joint="elbow" gear="2" forcerange="-3 3" forcelimited="true" '
        'gaintype="fixed" gainprm="0.5 0 0" biastype="affine" biasprm="0.5 0 0"/>'
    ]


def test_what_no_mjcf_can_say_is_told_in_a_comment_and_in_the_list(
    tmp_path: Path,
) -> None:
    loaded = load(tmp_path)
    effects = (
        AppliedEffect("command_delay", None, {"delay": 0.0412345678}),
        AppliedEffect("joint_offset", "shoulder", {"offset": 0.01}),
        AppliedEffect("load_friction", "shoulder", {"ratio": 0.1}),
    )
    write_corrected(loaded, verdict(*effects), tmp_path)
    removed, added = changed_lines((tmp_path / "model.diff").read_text())
    told = "<!-- not in this file but in effects.yaml:"
    assert added[:3] == [
        f"{told} command_delay, delay = 0.0412346 s -->",
        f"{told} joint_offset at shoulder, offset = 0.01 rad -->",
        f"{told} load_friction at shoulder, ratio = 0.1 -->",
    ]
    # Load friction also needs a friction constraint to act on, however small.
    assert len(removed) == 1
    assert 'frictionloss="1e-09"' in added[3]
    listed = read_effects(tmp_path / "effects.yaml")
    assert [e.name for e in listed.effects] == [e.name for e in effects]
    assert listed.effects[0].parameters == {"delay": 0.0412346}


def test_what_was_not_named_changes_nothing(tmp_path: Path) -> None:
    loaded = load(tmp_path)
    write_corrected(loaded, verdict(), tmp_path)
    assert (tmp_path / "model.xml").read_text() == ARM
    assert (tmp_path / "model.diff").read_text() == ""
    assert read_effects(tmp_path / "effects.yaml").effects == ()


def test_elements_without_a_name_are_found_by_their_place(tmp_path: Path) -> None:
    loaded = load(tmp_path)
    name = loaded.joints[2]
    friction = AppliedEffect("coulomb_friction", name, {"frictionloss": 0.5})
    text = corrected_xml(loaded, [friction], tmp_path)
    assert '<joint axis="0 0 1" frictionloss="0.5"/>' in text


def test_the_inertia_of_a_link_made_of_geoms_is_written_out(tmp_path: Path) -> None:
    loaded = load(tmp_path)
    heavier = AppliedEffect("link_inertia", "lower", {"factor": 1.5})
    text = corrected_xml(loaded, [heavier], tmp_path)
    assert "<!-- ours -->" in text
    corrected = mujoco.MjModel.from_xml_string(text)
    plain = mujoco.MjModel.from_xml_string(ARM)
    body = plain.body("lower").id
    assert corrected.body_mass[body] == pytest.approx(1.5 * plain.body_mass[body])
    np.testing.assert_allclose(
        corrected.body_inertia[body], 1.5 * plain.body_inertia[body]
    )


@pytest.mark.parametrize("inside", [True, False])
def test_included_files_and_meshes_are_found_from_the_new_folder(
    inside: bool, tmp_path: Path
) -> None:
    mesh = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "link.obj").write_text(mesh)
    bodies = '<body name="b"><joint name="j"/><geom type="mesh" mesh="link"/></body>'
    assets = '<asset><mesh file="link.obj"/></asset>'
    compiler = '<compiler meshdir="parts"/>'
    xml = f"<mujoco>{compiler}{assets}<worldbody>{bodies}</worldbody></mujoco>"
    if inside:
        (tmp_path / "bodies.xml").write_text(f"<mujocoinclude>{bodies}</mujocoinclude>")
        include = '<include file="bodies.xml"/>'
        xml = f"<mujoco>{compiler}{assets}<worldbody>{include}</worldbody></mujoco>"
    loaded = load(tmp_path, xml)
    out = tmp_path / "report"
    out.mkdir()
    friction = AppliedEffect("coulomb_friction", "j", {"frictionloss": 0.5})
    write_corrected(loaded, verdict(friction), out)
    corrected = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    assert corrected.dof_frictionloss.tolist() == [0.5]
    assert corrected.nmesh == 1
    # A file that includes another cannot be edited as text; it says so.
    assert ("written anew" in (out / "model.xml").read_text()) is inside


AWAY, EVEN = "xyz='.1 0 .02'", "ixy='0'"


def test_a_corrected_urdf_weighs_what_its_links_weigh(tmp_path: Path) -> None:
    """Fused, MuJoCo misplaces what is fixed with a turned inertia."""
    file = tmp_path / "arm.urdf"
    turned = urdf().replace(
        "<origin xyz='.1 0 .02'/>", "<origin xyz='.1 0 .02' rpy='1 2 3'/>"
    )
    file.write_text(turned.replace(EVEN, "ixy='.004'"))
    loaded = load_model(file)
    friction = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.2})
    corrected = mujoco.MjModel.from_xml_string(
        corrected_xml(loaded, (friction,), tmp_path)
    )
    assert corrected.joint("elbow").frictionloss == pytest.approx(0.2)
    for model in (corrected, loaded.model):
        data = mujoco.MjData(model)
        data.qpos[:] = 0.3, 0.4
        mujoco.mj_forward(model, data)
        # By hand: masses at 0.1, 0.02 of their links, links of 0.2, angles from level.
        lower = 0.3 + 0.4
        tool = 0.3 * 9.81 * (0.3 * np.cos(lower) + 0.02 * np.sin(lower))
        link = 0.5 * 9.81 * (0.1 * np.cos(lower) + 0.02 * np.sin(lower))
        assert data.qfrc_bias[1] == pytest.approx(-(tool + link), rel=1e-6)


def test_two_dashes_in_a_name_end_no_comment() -> None:
    text = with_notes("<mujoco>\n</mujoco>\n", ["not in this file: lag at a--b---"])
    assert "lag at a- -b- - - -->" in text
    assert parse(text).tag == "mujoco"
