"""Write the differences of two specs as changes of the MJCF file behind the first."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

import mujoco
import numpy as np

from rlco.gap.correct.xml_text import Editor, Element

# Attributes with the same name in a spec and in a file.
_JOINT = ("damping", "frictionloss", "armature", "stiffness", "springref")
_GEOM = ("friction", "solref")
_TURNS = ("axisangle", "euler", "xyaxes", "zaxis")
_SHORTCUTS = ("motor", "position", "velocity", "intvelocity", "damper", "cylinder")


class CannotEditError(Exception):
    """Raised if elements of the spec have no counterpart in the file."""


def write_changes(editor: Editor, before: mujoco.MjSpec, after: mujoco.MjSpec) -> None:
    """Edit a file so that it describes a changed spec.

    Args:
        editor: The file; changes are added to it.
        before: The spec of that file.
        after: A changed copy of it.

    Raises:
        CannotEditError: If elements of the spec have no counterpart in the file,
            because it includes or replicates others.
    """
    worlds = _sections(editor.root, "worldbody")
    _one(worlds)
    _body(editor, worlds[0], before.worldbody, after.worldbody)
    actuators = [e for s in _sections(editor.root, "actuator") for e in s.children]
    for element, old, new in _triples(actuators, before.actuators, after.actuators):
        _actuator(editor, element, old, new)
    pairs = [e for s in _sections(editor.root, "contact") for e in s.of("pair")]
    for element, old, new in _triples(pairs, before.pairs, after.pairs):
        editor_set(editor, element, _differences(old, new, _GEOM))
    if not _same(before.option.gravity, after.option.gravity):
        gravity = {"gravity": _text(after.option.gravity)}
        options = _sections(editor.root, "option")
        if options:
            editor.set(options[0], gravity)
        else:
            editor.append(editor.root, f"<option{_attributes(gravity)}/>")


def editor_set(editor: Editor, element: Element, changes: dict[str, str]) -> None:
    """Set attributes, if there are any."""
    if changes:
        editor.set(element, changes)


def _body(editor: Editor, element: Element, old: Any, new: Any) -> None:
    joints = list(element.of("joint", "freejoint"))
    for place, was, now in _triples(joints, old.joints, new.joints, more=True):
        if place is None:
            editor.append(element, _new_joint(now))
        else:
            editor_set(editor, place, _differences(was, now, _JOINT))
    for place, was, now in _triples(list(element.of("geom")), old.geoms, new.geoms):
        changes = _differences(was, now, _GEOM)
        if not _same(was.mass, now.mass):
            changes["mass"] = _text(now.mass)
        elif not np.isfinite(now.mass) and not _same(was.density, now.density):
            changes["density"] = _text(now.density)
        editor_set(editor, place, changes)
    _inertia(editor, element, old, new)
    bodies = list(element.of("body"))
    for place, was, now in _triples(bodies, old.bodies, new.bodies, more=True):
        if place is None:
            editor.append(element, _new_body(now))
        else:
            _body(editor, place, was, now)


def _inertia(editor: Editor, element: Element, old: Any, new: Any) -> None:
    if not new.explicitinertial:
        return
    full = np.isfinite(new.fullinertia).all()
    name = "fullinertia" if full else "diaginertia"
    numbers = new.fullinertia if full else new.inertia
    if not old.explicitinertial:
        editor.append(element, _inertial(new, name, numbers))
        return
    before = old.fullinertia if full else old.inertia
    changes: dict[str, str | None] = {}
    if not _same(old.mass, new.mass):
        changes["mass"] = _text(new.mass)
    if not _same(before, numbers):
        changes[name] = _text(numbers)
    if not _same(old.ipos, new.ipos):
        changes["pos"] = _text(new.ipos)
    if not _same(old.iquat, new.iquat):
        # Of the ways to write an orientation, a file may use only one.
        changes |= dict.fromkeys((*_TURNS, "fullinertia"))
        changes["quat"] = _text(new.iquat)
    places = list(element.of("inertial"))
    if changes:
        _one(places)
        editor.set(places[0], changes)


def _actuator(editor: Editor, element: Element, old: Any, new: Any) -> None:
    changes: dict[str, str | None] = {}
    if (
        not _same(old.forcerange, new.forcerange)
        or old.forcelimited != new.forcelimited
    ):
        changes |= {"forcerange": _text(new.forcerange), "forcelimited": "true"}
    same_bias = _same(np.delete(old.biasprm, 1), np.delete(new.biasprm, 1))
    stiffness = new.gainprm[0] == -new.biasprm[1]
    changed = not (_same(old.gainprm, new.gainprm) and _same(old.biasprm, new.biasprm))
    tag = None
    if changed and element.tag == "position" and same_bias and stiffness:
        changes["kp"] = _text(new.gainprm[0])
    elif changed:
        # The general form can express what the shortcuts cannot.
        if element.tag in _SHORTCUTS:
            tag = "general"
            changes |= dict.fromkeys(("kp", "kv", "dampratio", "timeconst"))
            if "inheritrange" in element.attributes:
                raise CannotEditError
        fixed = mujoco.mjtBias.mjBIAS_AFFINE
        changes |= {
            "gaintype": _GAINS[int(new.gaintype)],
            "gainprm": _text(_trimmed(new.gainprm, 3)),
            "biastype": "affine" if new.biastype == fixed else "none",
            "biasprm": _text(_trimmed(new.biasprm, 3)),
        }
        if new.biastype not in (fixed, mujoco.mjtBias.mjBIAS_NONE):
            raise CannotEditError
    if changes:
        editor.set(element, changes, tag)


_GAINS = {
    int(mujoco.mjtGain.mjGAIN_FIXED): "fixed",
    int(mujoco.mjtGain.mjGAIN_AFFINE): "affine",
}


def _new_joint(joint: Any) -> str:
    kinds = {mujoco.mjtJoint.mjJNT_HINGE: "hinge", mujoco.mjtJoint.mjJNT_SLIDE: "slide"}
    attributes: dict[str, Any] = {"name": joint.name, "type": kinds[joint.type]}
    attributes |= {name: _text(getattr(joint, name)) for name in ("pos", "axis")}
    # Zero is written, too: a class may have another value, or limits.
    attributes |= {name: _text(_trimmed(getattr(joint, name))) for name in _JOINT}
    attributes["limited"] = "false"
    return f"<joint{_attributes(attributes)}/>"


def _new_body(body: Any) -> str:
    inertial = _inertial(body, "diaginertia", body.inertia)
    place = _attributes({"pos": _text(body.pos)})
    return f"<body{place}>{inertial}</body>"


def _inertial(body: Any, name: str, numbers: Any) -> str:
    attributes = {"pos": _text(np.nan_to_num(body.ipos)), "mass": _text(body.mass)}
    if not _same(body.iquat, [1, 0, 0, 0]):
        attributes["quat"] = _text(body.iquat)
    return f"<inertial{_attributes({**attributes, name: _text(numbers)})}/>"


def _differences(old: Any, new: Any, names: Sequence[str]) -> dict[str, str]:
    return {
        name: _text(
            getattr(new, name)
            if name in _GEOM
            # Later values of these are coefficients of powers, zero by default.
            else _trimmed(getattr(new, name))
        )
        for name in names
        if not _same(getattr(old, name), getattr(new, name))
    }


def _triples(
    elements: Sequence[Element], old: Any, new: Any, *, more: bool = False
) -> list[tuple[Any, Any, Any]]:
    """Pair elements of the file with those of both specs, with new ones last."""
    old_ones, new_ones = list(old), list(new)
    if len(elements) != len(old_ones) or len(new_ones) < len(old_ones):
        raise CannotEditError
    if len(new_ones) > len(old_ones) and not more:
        raise CannotEditError
    return list(zip_longest(elements, old_ones, new_ones))


def _sections(root: Element, tag: str) -> list[Element]:
    return [child for child in root.children if child.tag == tag]


def _one(found: Sequence[Element]) -> None:
    if len(found) != 1:
        raise CannotEditError


def _same(one: Any, other: Any) -> bool:
    return np.array_equal(np.asarray(one), np.asarray(other), equal_nan=True)


def _trimmed(values: Any, least: int = 1) -> Any:
    """Return values without trailing zeros, but at least this many."""
    numbers = np.atleast_1d(np.asarray(values, dtype=float))
    used = np.flatnonzero(numbers)
    return numbers[: max(least, int(used[-1]) + 1 if used.size else 1)]


def _text(values: Any) -> str:
    return " ".join(f"{float(x):.10g}" for x in np.atleast_1d(values))


def _attributes(values: dict[str, Any]) -> str:
    return "".join(f' {name}="{value}"' for name, value in values.items())
