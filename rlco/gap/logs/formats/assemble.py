"""Tables made into recordings: columns side by side, in the model's order."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rlco.errors import DataError
from rlco.files import few
from rlco.gap.logs.formats.asynchronous import aligned
from rlco.gap.logs.formats.headers import POSE, parse_header, parse_pose
from rlco.gap.logs.formats.renames import LEFT_OUT, of_families
from rlco.gap.logs.formats.topic_choice import one_source
from rlco.gap.logs.log import Array, Log, Recording
from rlco.gap.logs.matching import (
    MEASURED,
    Names,
    bare_positions,
    counted_from_one,
    match_columns,
    without_strays,
)
from rlco.gap.logs.table import Column, Kind, Table, require_finite
from rlco.gap.model import LoadedModel

Found = Mapping[str, tuple[Column, Array]]
# A quaternion may be this much shorter or longer than one by rounding.
_ROUNDING = 0.01


def assemble(
    tables: Sequence[Table],
    model: LoadedModel | None,
    rename: Mapping[str, str] | None = None,
) -> Log:
    """Return the tables' columns in the model's order, in the units of their files.

    Without a model, joints and actuators are those of the log. Columns that are
    nobody's position, velocity, command or torque go into `Recording.extra`.

    Args:
        tables: One a recording, all with the same columns.
        model: The model, or None.
        rename: ``{name in the log: name in the model}``: of a joint, an actuator or a
            whole column, whose new name may give a quantity (``velocity.joint1``) or
            be ``-``, to leave it out: that column alone, where one has this header.
            What it says of a family of columns, see
            `rlco.gap.logs.formats.renames.of_families`.

    Raises:
        DataError: A name matches nothing, actions do not match the actuators, the
            recordings differ in their columns, or a number is none.
    """
    rename = of_families(tables[0], rename or {}, model)
    tables = [aligned(_renamed(table, rename, model)) for table in tables]
    tables = [one_source(without_strays(t, model), rename) for t in tables]
    tables = [bare_positions(counted_from_one(t), model) for t in tables]
    _refuse_unlike(tables)
    names = match_columns(tables[0], model)
    measured = [names.joints.get(stem) for stem in tables[0].of_kind("position")]
    joints = _ordered(measured, () if model is None else model.joints)
    sent = list(names.actuators.values())
    actuators = _ordered(sent, () if model is None else model.actuators)
    pose, task = tables[0].of_kind("pose"), model is not None and model.task
    if not joints and not pose and not task:
        raise DataError(f"{tables[0].name!r} holds no positions; give a log that does.")
    notes = list(names.notes)
    recordings = []
    for table in tables:
        recording, said = _recording(table, names, joints, actuators)
        recordings.append(recording)
        notes += [note for note in (*table.notes, *said) if note not in notes]
    body = _free_body(tables[0], model) if pose else None
    unused = () if task else tuple(c.header for c in _unused(tables[0], names, model))
    return Log(tuple(recordings), joints, actuators, body, tuple(notes), unused)


def _renamed(
    table: Table, rename: Mapping[str, str], model: LoadedModel | None
) -> Table:
    columns = []
    headers = {column.header for column, _ in table.columns}
    for column, values in table.columns:
        stem = rename.get(column.stem, rename.get(f"{column.source}/{column.stem}"))
        new = rename.get(column.header, stem)
        if new == LEFT_OUT and column.header not in rename and column.stem in headers:
            # A joint's name that is a header, too, leaves out that column alone.
            new = None
        if new != LEFT_OUT:
            here = column if new is None else _under(column, new, model)
            columns.append((here, values))
    return replace(table, columns=tuple(columns))


def _under(column: Column, new: str, model: LoadedModel | None) -> Column:
    joints = () if model is None else model.joints
    actuators = () if model is None else model.actuators
    meaning = parse_header(new, joints, actuators)
    if new in joints or new in actuators or meaning.kind == "extra":
        bare = "position" if meaning.kind == "extra" else meaning.kind
        kind = bare if column.kind == "extra" else column.kind
        return replace(column, kind=kind, stem=new)
    return replace(column, kind=meaning.kind, stem=meaning.stem)


def _refuse_unlike(tables: Sequence[Table]) -> None:
    first = {(c.kind, c.stem) for c, _ in tables[0].columns if c.kind != "extra"}
    for table in tables[1:]:
        here = {(c.kind, c.stem) for c, _ in table.columns if c.kind != "extra"}
        if here != first:
            differ = sorted(f"{kind} {stem}".strip() for kind, stem in here ^ first)
            raise DataError(
                f"recordings {tables[0].name!r} and {table.name!r} differ in their "
                f"columns ({few(differ)}); give recordings of one robot with the same "
                "columns."
            )


def _recording(
    table: Table, names: Names, joints: Sequence[str], actuators: Sequence[str]
) -> tuple[Recording, list[str]]:
    require_finite(repr(table.name), "time", table.time, None)
    found: dict[Kind, dict[str, tuple[Column, Array]]] = {}
    extra: dict[str, Array] = {}
    notes = []
    for column, values in table.columns:
        whose = names.actuators if column.kind == "command" else names.joints
        if column.kind == "pose":
            found.setdefault("pose", {})[column.stem] = (column, values)
        elif column.kind != "extra" and column.stem in whose:
            found.setdefault(column.kind, {})[whose[column.stem]] = (column, values)
        elif np.isfinite(values).all():
            extra[_aside(column)] = values
        else:
            notes.append(f"Column {column.header} has gaps and is left out.")
    for part in found.values():
        for column, values in part.values():
            require_finite(repr(table.name), column.header, values, table.time)
    channels: dict[Kind, Array | None] = {"pose": _pose(table, found.get("pose", {}))}
    for kind in (*MEASURED, "command"):
        order = actuators if kind == "command" else joints
        part = found.get(kind, {})
        lacking = [name for name in order if name not in part]
        if part and lacking:
            extra |= {column.header: values for column, values in part.values()}
            notes.append(f"The log has no {kind} of {few(lacking)}: none is used.")
        channels[kind] = _side_by_side(part, order) if part and not lacking else None
    recording = Recording(
        table.name,
        table.time,
        position=channels["position"],
        velocity=channels["velocity"],
        command=channels["command"],
        torque=channels["torque"],
        pose=channels["pose"],
        extra=extra,
        facts=table.facts,
        device=table.device,
    )
    return recording, notes


def _unused(table: Table, names: Names, model: LoadedModel | None) -> Iterator[Column]:
    """Give the columns that no comparison reads."""
    for column, _ in table.columns:
        whose = names.actuators if column.kind == "command" else names.joints
        if column.kind != "pose" and column.stem not in whose:
            yield column


def _aside(column: Column) -> str:
    """Return the name of a column that is kept in `Recording.extra`."""
    named = column.kind == "position" and not column.stem.isdecimal()
    return column.stem if named else column.header


def _side_by_side(found: Found, order: Sequence[str]) -> Array:
    return np.column_stack([np.asarray(found[name][1], dtype=float) for name in order])


def _pose(table: Table, found: Found) -> Array | None:
    if not found:
        return None
    pose = _side_by_side(found, POSE)
    norm = np.linalg.norm(pose[:, 3:], axis=1)
    off = np.abs(norm - 1.0) > _ROUNDING
    if off.any():
        row = int(off.argmax())
        raise DataError(
            f"the quaternion of {table.name!r} has length {norm[row]:.3f} in row "
            f"{row + 1}, not 1; give qw, qx, qy, qz of one orientation."
        )
    pose[:, 3:] /= norm[:, None]
    # A quaternion and its negative are one orientation: take the nearer to the last.
    turns = np.sum(pose[1:, 3:] * pose[:-1, 3:], axis=1) < 0
    pose[1:, 3:] *= np.where(np.cumsum(turns) % 2, -1.0, 1.0)[:, None]
    return pose


def _free_body(table: Table, model: LoadedModel | None) -> str | None:
    poses = {parse_pose(c.header) for c, _ in table.columns if c.kind == "pose"}
    named = [found[0] for found in poses if found is not None]
    if model is None:
        return named[0] or None if named else None
    bodies = model.free_bodies
    if named and named[0] in bodies:
        return named[0]
    if len(bodies) != 1:
        raise DataError(
            f"the log has the pose of one free body and model {model.name!r} has "
            f"{len(bodies)} ({few(bodies) or 'none'}); give a model with one body on a "
            "free joint."
        )
    return bodies[0]


def _ordered(names: Sequence[str | None], order: Sequence[str]) -> tuple[str, ...]:
    known = [name for name in order if name in names]
    return (*known, *(name for name in names if name and name not in known))
