"""Write the corrected model: the user's file with the effects applied.

`model.xml` is the user's file, edited as text where effects change a value or add an
element, so that `model.diff` is as short as the change. `effects.yaml` contains all
effects, including those that MJCF cannot express; `rlco.envs.make_env` applies them
all.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from xml.parsers.expat import ExpatError

import mujoco
import numpy as np

from rlco.gap.compare.verdict import Verdict
from rlco.gap.correct.xml_changes import CannotEditError, write_changes
from rlco.gap.correct.xml_text import Editor, Element
from rlco.gap.model import LoadedModel
from rlco.physics.effects import EFFECTS, AppliedEffect
from rlco.physics.effects.apply import apply_to_spec
from rlco.physics.effects.effects_file import write_effects
from rlco.physics.effects.names import plain_name
from rlco.physics.mj.model_struct import array_fields
from rlco.physics.spec.sample import Sample, content_of

_FOLDERS = ("meshdir", "texturedir", "assetdir")


def write_corrected(
    loaded: LoadedModel, verdict: Verdict, out: str | Path
) -> list[Path]:
    """Write ``model.xml``, ``model.diff`` and ``effects.yaml`` for the named effects.

    Args:
        loaded: The user's model.
        verdict: The result of the search; its named effects, as fitted, are applied.
        out: An existing folder.

    Returns:
        The three files.
    """
    effects = [rounded(effect) for effect in verdict.hypothesis.effects]
    text = corrected_xml(loaded, effects, out)
    return write_files(loaded, text, effects, out, sample=_sample(verdict, effects))


def write_files(
    loaded: LoadedModel,
    text: str,
    effects: list[AppliedEffect],
    out: str | Path,
    *,
    sample: Sample | None = None,
) -> list[Path]:
    """Write a corrected model, what changed in it, and effects; return the files.

    Args:
        loaded: The model before.
        text: The model after.
        effects: What ``effects.yaml`` lists.
        out: An existing folder.
        sample: Parameter sets of the effects, which it lists too.
    """
    model, diff, listed = (
        Path(out) / name for name in ("model.xml", "model.diff", "effects.yaml")
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
    write_effects(
        listed,
        effects,
        names=_names(effects),
        units=_units(loaded, effects),
        sample=None if sample is None else content_of(sample, effects),
    )
    return [model, diff, listed]


def _sample(verdict: Verdict, effects: list[AppliedEffect]) -> Sample | None:
    """Return a verdict's parameter sets, with six digits, for effects as written."""
    if verdict.sample is None:
        return None
    places = {(effect.name, effect.target): i for i, effect in enumerate(effects)}
    columns = tuple(
        (places[effect.name, effect.target], parameter)
        for effect in verdict.effects
        for parameter in effect.parameters
    )
    rows = tuple(
        tuple(float(f"{value:.6g}") for value in row) for row in verdict.sample
    )
    return Sample(columns, rows)


def _lines(text: str) -> list[str]:
    """Return the lines of a file, with patch's mark if it lacks a final newline."""
    lines = text.splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n\\ No newline at end of file\n"
    return lines


def corrected_xml(
    loaded: LoadedModel, effects: Iterable[AppliedEffect], out: str | Path
) -> str:
    """Return the user's XML with the effects that MJCF can express.

    The text is edited where this gives exactly the model that changing the spec gives.
    Otherwise (a file that includes or replicates others) MuJoCo writes it anew.

    Args:
        loaded: The user's model.
        effects: The effects.
        out: The folder of the new file: paths of meshes are relative to it.
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
        _rebase_paths(editor, loaded, Path(out))
        text = with_notes(editor.result(), notes)
        if _same_model(_compiled(text, loaded, Path(out)), after.copy().compile()):
            return text
    except (CannotEditError, ExpatError):
        pass
    notes.append("written anew by MuJoCo: as text it could not be edited")
    editor = Editor(str(after.to_xml()))
    _rebase_paths(editor, loaded, Path(out))
    return with_notes(editor.result(), notes)


def _spec(loaded: LoadedModel) -> mujoco.MjSpec:
    if loaded.path is None:
        return mujoco.MjSpec.from_string(loaded.source)
    spec = mujoco.MjSpec.from_file(str(loaded.path))
    if loaded.path.suffix.lower() == ".urdf":
        # MuJoCo fuses a URDF's fixed links, and misplaces the centre of mass of rotated
        # inertias (its pull request 3250): the corrected model keeps them separate.
        spec.compiler.fusestatic = False
    return spec


def whole_spec(loaded: LoadedModel) -> mujoco.MjSpec:
    """Return the user's whole model, with the names that effects and logs use."""
    spec = _spec(loaded)
    _name_all_like(spec, loaded.spec)
    return spec


def _name_all_like(spec: mujoco.MjSpec, slim: mujoco.MjSpec) -> None:
    """Give unnamed joints, bodies and actuators the names that effects use."""
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
    """Write the inertia of links that derive it from their geoms."""
    for effect in effects:
        if effect.name not in ("link_inertia", "link_parameters"):
            continue
        body, known = spec.body(effect.target), loaded.model.body(effect.target)
        # All of them need the frame of the inertia, which a file may give as angles.
        if not body.explicitinertial or effect.name == "link_parameters":
            body.explicitinertial = True
            body.mass, body.ipos = known.mass[0], known.ipos
            body.iquat, body.inertia = known.iquat, known.inertia
            body.fullinertia = np.full(6, np.nan)
            body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def rounded(effect: AppliedEffect) -> AppliedEffect:
    """Round an effect to six digits, which exceeds the accuracy of any measurement."""
    numbers = {k: float(f"{v:.6g}") for k, v in effect.parameters.items()}
    return replace(effect, parameters=numbers)


def _names(effects: Iterable[AppliedEffect]) -> dict[str, str]:
    """Return the targets whose names robosuite prefixes, by their original names."""
    targets = {effect.target for effect in effects if effect.target is not None}
    return {plain_name(t): t for t in sorted(targets) if plain_name(t) != t}


def _units(
    loaded: LoadedModel, effects: Iterable[AppliedEffect]
) -> dict[str, dict[str, str]]:
    units: dict[str, dict[str, str]] = {}
    for effect in effects:
        parameters = EFFECTS[effect.name].parameters(loaded.model, effect.target)
        units[_place(effect)] = {p.name: p.unit for p in parameters}
    return units


def _place(effect: AppliedEffect) -> str:
    return f"{effect.name} {effect.target}"


def _notes(loaded: LoadedModel, effects: Iterable[AppliedEffect]) -> list[str]:
    """Return a line for each effect that MJCF cannot express."""
    notes = []
    units = _units(loaded, effects)
    for effect in effects:
        known = EFFECTS[effect.name]
        if known.acts_on - {"model"}:
            place = f" at {effect.target}" if effect.target else ""
            numbers = ", ".join(
                f"{k} = {v:g} {units[_place(effect)][k]}".rstrip()
                for k, v in effect.parameters.items()
            )
            notes.append(f"not in this file but in effects.yaml: {known.name}{place}")
            notes[-1] += f", {numbers}"
    return notes


def with_notes(text: str, notes: list[str]) -> str:
    """Return a file with notes as comments at its top, one a line."""
    if not notes:
        return text
    end = Editor(text).root.stop
    # Two dashes would end a comment, and names may have them.
    plain = [re.sub("-(?=-)", "- ", note) for note in notes]
    lines = "".join(f"\n  <!-- {note} -->" for note in plain)
    raw = text.encode()
    return (raw[:end] + lines.encode() + raw[end:]).decode()


def _rebase_paths(editor: Editor, loaded: LoadedModel, out: Path) -> None:
    """Set the paths of meshes and textures relative to another folder."""
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
    rebased: dict[str, str | None] = {
        name: os.path.normpath(os.path.join(away, folder))
        for name, folder in folders.items()
    }
    if compilers:
        editor.set(compilers[0], {**rebased, "assetdir": None})
    else:
        attributes = " ".join(f'{name}="{folder}"' for name, folder in rebased.items())
        editor.append(root, f"<compiler {attributes}/>")


def _compiled(text: str, loaded: LoadedModel, out: Path) -> mujoco.MjModel | None:
    """Compile a text as if in a folder; return None if it has errors."""
    part = out / ".model.part.xml"
    part.write_text(text, "utf-8")
    try:
        return mujoco.MjModel.from_xml_path(str(part))
    except ValueError:
        return None
    finally:
        part.unlink()


def _same_model(one: mujoco.MjModel | None, other: mujoco.MjModel) -> bool:
    """Return whether two models agree to ten digits, names aside."""
    if one is None:
        return False
    for name in array_fields():
        a, b = getattr(one, name), getattr(other, name)
        if a.shape != b.shape or not np.allclose(a, b, 1e-8, 1e-12, equal_nan=True):
            return False
    return bool(np.allclose(one.opt.gravity, other.opt.gravity, 1e-8, 1e-12))
