"""A log's columns matched to the joints and actuators of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from rlco.errors import DataError, counted, suggest
from rlco.files import few
from rlco.gap.logs.names import match_names
from rlco.gap.logs.table import Kind, Table
from rlco.gap.model import LoadedModel
from rlco.physics.effects.targets import actuated_joint

MEASURED: tuple[Kind, ...] = ("position", "velocity", "torque")
_HINT = (
    "give rename={'name in the log': 'name in the model'}, in a recipe "
    "rename=IN_LOG:IN_MODEL"
)


@dataclass(frozen=True)
class Names:
    """Which stem of the log is which joint or actuator: ``{stem: ours}``."""

    joints: dict[str, str]
    actuators: dict[str, str]
    notes: tuple[str, ...] = ()


def match_columns(table: Table, model: LoadedModel | None) -> Names:
    """Match a table's stems to a model's joints and actuators.

    Without a model each is its own name.

    Raises:
        DataError: A name matches nothing, or actions do not match the actuators.
    """
    every = [stem for kind in MEASURED for stem in table.of_kind(kind)]
    every = list(dict.fromkeys(every))
    sent = list(table.of_kind("command"))
    if model is None:
        return Names(_own(table, every, "joint"), _own(table, sent, "actuator"))
    joints = _match_joints(every, model)
    if model.task is None:
        _refuse_unmatched(table, joints, model)
        actuators = _match_actuators(sent, model)
    else:
        # A task's own actions are not actuators of its model.
        actuators = {stem: stem for stem in sent}
    return Names(joints, actuators, tuple(_notes(table, joints, actuators, model)))


def _own(table: Table, stems: Sequence[str], alone: str) -> dict[str, str]:
    """Name columns by themselves: a number by its whole header."""
    headers = {column.stem: column.header for column, _ in reversed(table.columns)}
    return {s: headers[s] if s.isdecimal() else s or alone for s in stems}


def bare_positions(table: Table, model: LoadedModel | None) -> Table:
    """Take columns without a quantity for positions, where there are no others.

    They must match all the model's joints: ``fer_joint1`` the joint ``joint1``.
    """
    if model is None or table.of_kind("position"):
        return table
    found = match_names(list(table.of_kind("extra")), model.joints)
    if not model.joints or len(found) < len(model.joints):
        return table
    columns = tuple(
        (replace(c, kind="position") if c.stem in found else c, values)
        for c, values in table.columns
    )
    return replace(table, columns=columns)


def counted_from_one(table: Table) -> Table:
    """Let counts of joints start at 1 in each quantity: ``q1`` beside ``tau[0]``."""
    from_zero = [
        kind
        for kind in (*MEASURED, "command")
        for stems in [list(table.of_kind(kind))]
        if "0" in stems and all(stem.isdecimal() for stem in stems)
    ]
    columns = tuple(
        (replace(c, stem=str(int(c.stem) + 1)) if c.kind in from_zero else c, values)
        for c, values in table.columns
    )
    return replace(table, columns=columns)


def without_strays(table: Table, model: LoadedModel | None) -> Table:
    """Set aside what reads like a joint's name beside joints that are counted.

    ``speed_scaling`` and ``runtime_state`` beside ``actual_q_0`` are not joints.
    """
    if model is None:
        return table
    names = (*model.joints, *model.actuators)
    strays: set[tuple[Kind, str]] = set()
    for kind in (*MEASURED, "command"):
        stems = list(table.of_kind(kind))
        counted = [stem for stem in stems if stem.isdecimal()]
        others = [stem for stem in stems if not stem.isdecimal()]
        if len(counted) > 1 and others and not match_names(others, names):
            strays |= {(kind, stem) for stem in others}
    columns = tuple(
        (
            replace(c, kind="extra", stem=c.header)
            if (c.kind, c.stem) in strays
            else c,
            values,
        )
        for c, values in table.columns
    )
    return replace(table, columns=columns)


def _match_joints(stems: Sequence[str], model: LoadedModel) -> dict[str, str]:
    """Match by the joints' names, or by those of the actuators that drive them."""
    found = match_names(stems, model.joints)
    driven = _driven(model)
    other = match_names(stems, list(driven))
    if len(other) > len(found):
        return {stem: driven[name] for stem, name in other.items()}
    return found


def _match_actuators(stems: Sequence[str], model: LoadedModel) -> dict[str, str]:
    """Match by the actuators' names, or by those of the joints that they drive."""
    if not stems:
        return {}
    found = match_names(stems, model.actuators)
    by_joint = {joint: name for name, joint in _driven(model).items()}
    other = match_names(stems, list(by_joint))
    if len(other) > len(found):
        found = {stem: by_joint[joint] for stem, joint in other.items()}
    logged = f"the log has {counted(len(stems), 'action')} ({few(stems)})"
    if not model.actuators:
        raise DataError(
            f"{logged} and model {model.name!r} has no actuators; give an MJCF file "
            "with a position servo per joint, or, where the log has torques, leave the "
            f"actions out with '-' as their new name ({_HINT[5:]})."
        )
    lacking = [name for name in model.actuators if name not in found.values()]
    left = [stem for stem in stems if stem not in found]
    if lacking or left:
        raise DataError(
            f"{logged} and model {model.name!r} has "
            f"{counted(len(model.actuators), 'actuator')} "
            f"({few(model.actuators) or 'none'}), which do not match"
            f"{_nearest(left, lacking)}; give the model that was commanded, or "
            f"{_HINT[5:]}, and '-' as the new name of an action to leave out."
        )
    return found


def _refuse_unmatched(table: Table, joints: dict[str, str], model: LoadedModel) -> None:
    positions = list(table.of_kind("position"))
    if table.of_kind("pose") and not positions:
        return
    # A joint's velocity or torque alone is of no use here.
    placed = [joints[stem] for stem in positions if stem in joints]
    lacking = [name for name in model.joints if name not in placed]
    headers = {column.stem: column.header for column, _ in reversed(table.columns)}
    left = [stem for stem in positions if stem not in joints]
    # Without a quantity in its header a column may be a joint that is misspelt.
    spare = [stem for stem in table.of_kind("extra") if stem not in joints]
    near = [stem for stem in spare if suggest(stem, lacking)] if joints else spare
    some = [*left, *near]
    if (lacking and some) or not placed:
        odd = [
            stem if stem and not stem.isdecimal() else headers[stem] for stem in some
        ]
        raise DataError(
            f"no joint of model {model.name!r} matches the log's "
            f"{counted(len(odd), 'column')} {few(odd)}{_nearest(odd, lacking)}; "
            f"its joints without a column: {few(lacking) or 'none'}; {_HINT}."
            if odd
            else f"the log has no joint positions and model {model.name!r} has joints "
            f"{few(model.joints) or 'none'}; give a log of this robot, or {_HINT[5:]}."
        )


def _notes(
    table: Table,
    joints: dict[str, str],
    actuators: dict[str, str],
    model: LoadedModel,
) -> list[str]:
    notes = []
    driven = _driven(model)
    for what, found in (("joints", joints), ("actions", actuators)):
        named = {a: b for a, b in found.items() if a and not a.isdecimal()}
        # A joint and what drives it are one to most loggers.
        same = {(b, b) for b in named.values()} | {*driven.items()}
        same |= {(joint, actuator) for actuator, joint in driven.items()}
        other = [f"{a} as {b}" for a, b in named.items() if (a, b) not in same]
        if other:
            notes.append(f"The log's {what} have other names: {few(other)}.")
        counted = [b for a, b in found.items() if a.isdecimal()]
        if counted:
            notes.append(f"The log counts its {what}, read in order: {few(counted)}.")
    if model.task is not None and not joints:
        return notes  # a log of the task's tool and objects
    unmeasured = [name for name in model.joints if name not in joints.values()]
    if unmeasured and table.of_kind("position"):
        notes.append(f"The log has no positions of {few(unmeasured)}.")
    spare = [stem for stem in table.of_kind("position") if stem not in joints]
    if spare:
        notes.append(
            f"The model has no joints {few(spare)}: their columns are not used."
        )
    return notes


def _driven(model: LoadedModel) -> dict[str, str]:
    """Return the joint that each actuator drives, of those that drive one."""
    pairs = [
        (name, actuated_joint(model.model, index))
        for index, name in enumerate(model.actuators)
    ]
    return {name: joint for name, joint in pairs if joint is not None}


def _nearest(given: Sequence[str], allowed: Sequence[str]) -> str:
    hints = [f"{name!r}{suggest(name, allowed)}" for name in given]
    hints = [hint for hint in hints if "did you mean" in hint]
    return f": {', '.join(hints[:3])}" if hints else ""
