"""The mended model: the user's own file with the effects in it, and what it cannot say.

`model.xml` is the user's file, edited as text where effects change a number or add an
element, so that `model.diff` is as short as the change. `effects.yaml` holds all
effects, those that no MJCF can say too; `rlco.envs.make_env` applies them all.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from xml.parsers.expat import ExpatError

import mujoco
import numpy as np

from rlco.gap.model import LoadedModel
from rlco.gap.problem import Verdict
from rlco.gap.xml_changes import CannotEditError, write_changes
from rlco.gap.xml_text import Editor, Element
from rlco.physics.effects import EFFECTS, AppliedEffect
from rlco.physics.effects.apply import apply_to_spec
from rlco.physics.effects.effects_file import write_effects
from rlco.physics.effects.names import plain_name
from rlco.physics.model_struct import array_fields

_FOLDERS = ("meshdir", "texturedir", "assetdir")


def write_mend(loaded: LoadedModel, verdict: Verdict, out: str | Path) -> list[Path]:
    """Write ``model.xml``, ``model.diff`` and ``effects.yaml`` of what was named.

    Args:
        loaded: The user's model.
        verdict: What was found; its named effects, as fitted, are applied.
        out: An existing folder.

    Returns:
        The three files.
    """
    out = Path(out)
    effects = [_rounded(effect) for effect in verdict.hypothesis.effects]
    text = mended_xml(loaded, effects, out)
    model, diff, listed = (
        out / name for name in ("model.xml", "model.diff", "effects.yaml")
    )
    model.write_text(text, "utf-8")
    original = loaded.path.name if loaded.path else f"{loaded.name}.xml"
    lines = difflib.unified_diff(
        _lines(loaded.source),
        _lines(text),
        f"a/{original}",
        "b/model.xml",
    )
    diff.write_text("".join(lines), "utf-8")
    write_effects(listed, effects, names=_names(effects), units=_units(loaded, effects))
    return [model, diff, listed]


def _lines(text: str) -> list[str]:
    """Return the lines of a file, the last marked as patch wants it if it is open."""
    lines = text.splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n\\ No newline at end of file\n"
    return lines


def mended_xml(
    loaded: LoadedModel, effects: Iterable[AppliedEffect], out: str | Path
) -> str:
    """Return the user's XML with the effects in it that MJCF can say.

    The text is edited where that gives the very model that changing the spec gives;
    else (a file that includes or replicates others) MuJoCo writes it anew.

    Args:
        loaded: The user's model.
        effects: The effects.
        out: The folder that the file is for: paths of meshes are told from there.
    """
    effects = list(effects)
    before = _spec(loaded)
    named = before.copy()
    _name_all_like(named, loaded.spec)
    after = named.copy()
    _write_inertias(after, loaded, effects)
    apply_to_spec(after, effects)
    notes = _notes(loaded, effects)
    try:
        editor = Editor(loaded.source)
        write_changes(editor, before, after)
        _tell_paths_from(editor, loaded, Path(out))
        text = _with_notes(editor.result(), notes)
        if _same_model(_compiled(text, loaded, Path(out)), after.copy().compile()):
            return text
    except (CannotEditError, ExpatError):
        pass
    notes.append("written anew by MuJoCo: as text it could not be edited")
    editor = Editor(str(after.to_xml()))
    _tell_paths_from(editor, loaded, Path(out))
    return _with_notes(editor.result(), notes)


def _spec(loaded: LoadedModel) -> mujoco.MjSpec:
    if loaded.path is None:
        return mujoco.MjSpec.from_string(loaded.source)
    spec = mujoco.MjSpec.from_file(str(loaded.path))
    if loaded.path.suffix.lower() == ".urdf":
        # MuJoCo fuses a URDF's fixed links, and with turned inertias misplaces their
        # centre of mass (its pull request 3250): the mended model keeps them apart.
        spec.compiler.fusestatic = False
    return spec


def _name_all_like(spec: mujoco.MjSpec, slim: mujoco.MjSpec) -> None:
    """Give nameless joints, bodies and actuators the names that effects use."""
    for ours, theirs in (
        (spec.joints, slim.joints),
        (spec.bodies, slim.bodies),
        (spec.actuators, slim.actuators),
    ):
        for element, named in zip(ours, theirs, strict=True):
            if not element.name:
                element.name = named.name


def _write_inertias(
    spec: mujoco.MjSpec, loaded: LoadedModel, effects: Iterable[AppliedEffect]
) -> None:
    """Write out the inertia of links that have it from their geoms."""
    for effect in effects:
        if effect.name != "link_inertia":
            continue
        body, known = spec.body(effect.target), loaded.model.body(effect.target)
        if not body.explicitinertial:
            body.explicitinertial = True
            body.mass, body.ipos = known.mass[0], known.ipos
            body.iquat, body.inertia = known.iquat, known.inertia


def _rounded(effect: AppliedEffect) -> AppliedEffect:
    """Return an effect with six digits: more of them nothing was measured with."""
    numbers = {k: float(f"{v:.6g}") for k, v in effect.parameters.items()}
    return replace(effect, parameters=numbers)


def _names(effects: Iterable[AppliedEffect]) -> dict[str, str]:
    """Return the targets whose names robosuite has prefixed, by their plain names."""
    targets = {effect.target for effect in effects if effect.target is not None}
    return {plain_name(t): t for t in sorted(targets) if plain_name(t) != t}


def _units(
    loaded: LoadedModel, effects: Iterable[AppliedEffect]
) -> dict[str, dict[str, str]]:
    units: dict[str, dict[str, str]] = {}
    for effect in effects:
        parameters = EFFECTS[effect.name].parameters(loaded.model, effect.target)
        units[effect.name] = {p.name: p.unit for p in parameters}
    return units


def _notes(loaded: LoadedModel, effects: Iterable[AppliedEffect]) -> list[str]:
    """Return a line for each effect that acts where no MJCF reaches."""
    notes = []
    units = _units(loaded, effects)
    for effect in effects:
        known = EFFECTS[effect.name]
        if known.on_command or known.on_measurement or known.on_step:
            place = f" at {effect.target}" if effect.target else ""
            numbers = ", ".join(
                f"{k} = {v:g} {units[effect.name][k]}".rstrip()
                for k, v in effect.parameters.items()
            )
            notes.append(f"not in this file but in effects.yaml: {known.name}{place}")
            notes[-1] += f", {numbers}"
    return notes


def _with_notes(text: str, notes: list[str]) -> str:
    if not notes:
        return text
    end = Editor(text).root.stop
    lines = "".join(f"\n  <!-- {note} -->" for note in notes)
    raw = text.encode()
    return (raw[:end] + lines.encode() + raw[end:]).decode()


def _tell_paths_from(editor: Editor, loaded: LoadedModel, out: Path) -> None:
    """Tell where meshes and textures lie as seen from another folder."""
    if loaded.path is None or loaded.path.parent.resolve() == out.resolve():
        return
    root = editor.root
    files = [e for a in root.of("asset") for e in a.children if "file" in e.attributes]
    if not files:
        return
    away = os.path.relpath(loaded.path.parent.resolve(), out.resolve())
    compilers: list[Element] = list(root.of("compiler"))
    known = {k: v for c in compilers for k, v in c.attributes.items() if k in _FOLDERS}
    folder = known.pop("assetdir", None)
    folders = {"meshdir": folder or ".", "texturedir": folder or ".", **known}
    told: dict[str, str | None] = {
        name: os.path.normpath(os.path.join(away, folder))
        for name, folder in folders.items()
    }
    if compilers:
        editor.set(compilers[0], {**told, "assetdir": None})
    else:
        shown = " ".join(f'{name}="{folder}"' for name, folder in told.items())
        editor.append(root, f"<compiler {shown}/>")


def _compiled(text: str, loaded: LoadedModel, out: Path) -> mujoco.MjModel | None:
    """Return the model of a text as it will lie in a folder; None if it has errors."""
    part = out / ".model.part.xml"
    part.write_text(text, "utf-8")
    try:
        return mujoco.MjModel.from_xml_path(str(part))
    except ValueError:
        return None
    finally:
        part.unlink()


def _same_model(one: mujoco.MjModel | None, other: mujoco.MjModel) -> bool:
    """Return whether two models are the same to ten digits, names aside."""
    if one is None:
        return False
    for name in array_fields():
        a, b = getattr(one, name), getattr(other, name)
        if a.shape != b.shape or not np.allclose(a, b, 1e-8, 1e-12, equal_nan=True):
            return False
    return bool(np.allclose(one.opt.gravity, other.opt.gravity, 1e-8, 1e-12))
