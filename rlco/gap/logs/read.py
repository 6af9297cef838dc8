"""Reading a log: the files given determine the format."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rlco.errors import DataError, suggest
from rlco.files import few
from rlco.gap.logs.checks import check_log
from rlco.gap.logs.formats.assemble import assemble
from rlco.gap.logs.formats.bam_files import is_bam, read_bam
from rlco.gap.logs.formats.csv_files import read_csv
from rlco.gap.logs.formats.dynamixel import steps_to_degrees
from rlco.gap.logs.formats.headers import unit_factor
from rlco.gap.logs.formats.lerobot_folders import read_lerobot
from rlco.gap.logs.formats.npz_files import read_npz
from rlco.gap.logs.lengths import to_metres
from rlco.gap.logs.log import Log
from rlco.gap.logs.table import Table
from rlco.gap.logs.times.read_times import at_read_times
from rlco.gap.logs.times.timing import correct_timing
from rlco.gap.logs.units import to_radians
from rlco.gap.model import LoadedModel

_FORMATS = "a LeRobot folder, CSV, NPZ, a rosbag2 (.mcap, .db3) or BAM's JSON"
_BAGS = (".mcap", ".db3")
_SUFFIXES = (".csv", ".npz", *_BAGS, ".json")
#: Fewer rows of joints are no motion: one to start from, and two to compare.
_FEWEST_ROWS = 3


def read_log(
    path: str | Path,
    model: LoadedModel | None = None,
    *,
    rename: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    angles: str | None = None,
) -> Log:
    """Read a robot's recordings, check them, and put them in the model's order.

    What is read:

    - A LeRobot data set, v2.1 or v3: ``observation.state`` (joint positions, named as
      the model's joints), ``observation.velocity``, ``observation.effort`` or
      ``observation.torque``, and ``action`` (named as its actuators).
    - CSV with a header, and NPZ: see `rlco.gap.logs.formats.headers` for the names,
      such as ``time,q1,q2,dq1,dq2,tau1,tau2`` or ``time_ms,elbow,cmd_elbow``.
    - A free body's pose: ``x,y,z,qw,qx,qy,qz``.
    - ``sensor_msgs/JointState`` of a rosbag2 (``.mcap``, ``.db3`` or a bag's folder),
      and what ros2_control's controllers were sent.
    - BAM's JSON.

    A folder of several CSV, NPZ, ``.mcap``, ``.db3`` or JSON files, or of several bags'
    folders, is that many recordings.

    Args:
        path: A file or a folder.
        model: The robot's model; without, joints are named as in the log and nothing
            is checked against ranges.
        rename: ``{name in the log: name in the model}`` for joints, actuators,
            columns, or features of a LeRobot data set; ``-`` leaves out.
        scale: ``{column in the log: factor}``, multiplied before anything else: the
            torque constant times the gear ratio of a current, which `rename` then calls
            a torque.
        angles: ``degrees`` or ``radians`` where it is known; None to detect it.

    Returns:
        The log, in SI units, with notes on all that was noticed and corrected.

    Raises:
        DataError: The log cannot be used as it is.
        UnknownNameError: `angles` is neither.
    """
    path = Path(path)
    rename = dict(rename or {})
    if not path.exists():
        raise DataError(f"log {str(path)!r} does not exist; give {_FORMATS}.")
    if (path / "meta").is_dir():
        tables, rename = read_lerobot(path, model, rename)
    else:
        tables = [table for file in _files(path) for table in _read(file, model)]
    tables = [_in_si(_scaled(table, scale or {}), scale or {}) for table in tables]
    tables = [steps_to_degrees(table) for table in tables]
    log = _corrected(assemble(tables, model, rename))
    angles = angles or _header_angles(tables)
    log = to_radians(log, None if model is None else model.model, angles)
    if log.body is not None and model is not None:
        log = to_metres(log, model.model)
    return replace(log, notes=(*log.notes, *check_log(log, model)))


def _scaled(table: Table, scale: Mapping[str, float]) -> Table:
    """Return a table with some columns multiplied.

    Raises:
        DataError: There is no such column, or a factor is 0 or not finite.
    """
    headers = [column.header for column, _ in table.columns]
    for header, factor in scale.items():
        if header not in headers:
            raise DataError(
                f"scale names column {header!r}{suggest(header, headers)}, which "
                f"recording {table.name!r} does not have; it has {few(headers)}."
            )
        if not math.isfinite(factor) or factor == 0.0:
            raise DataError(
                f"scale gives column {header!r} the factor {factor}; give a number "
                "other than 0."
            )
    columns = [
        (column, values * scale[column.header] if column.header in scale else values)
        for column, values in table.columns
    ]
    return replace(table, columns=tuple(columns))


def _in_si(table: Table, known: Collection[str]) -> Table:
    """Return a table with what its headers say is in mrad, rpm or mm converted.

    Args:
        table: One recording.
        known: Headers of columns for which a factor was given.
    """
    factors = {
        column.header: unit_factor(column.header)
        for column, _ in table.columns
        if column.header not in known
    }
    other = [header for header, factor in factors.items() if factor != 1.0]
    if not other:
        return table
    columns = tuple((c, v * factors.get(c.header, 1.0)) for c, v in table.columns)
    note = f"Converted from the units in their headers: {few(other)}."
    return replace(table, columns=columns, notes=(*table.notes, note))


def _files(path: Path) -> list[Path]:
    """Return the files of one format that a path names or holds."""
    if path.is_file():
        if path.suffix.lower() not in _SUFFIXES:
            raise DataError(f"log {str(path)!r} has no known format; give {_FORMATS}.")
        return [path]
    if not path.is_dir():
        raise DataError(f"log {str(path)!r} is no file and no folder; give {_FORMATS}.")
    if _is_bag(path):
        return [path]
    bags = sorted(folder for folder in path.iterdir() if _is_bag(folder))
    found = {
        suffix: sorted(p for p in path.iterdir() if p.suffix.lower() == suffix)
        for suffix in _SUFFIXES
    }
    # JSON beside other files describes them.
    found[".json"] = [file for file in found[".json"] if is_bam(file)]
    found["bags"] = bags
    there = {suffix: files for suffix, files in found.items() if files}
    if len(there) > 1:
        counts = [f"{len(files)} {suffix}" for suffix, files in there.items()]
        raise DataError(
            f"folder {str(path)!r} holds files of several formats ({few(counts)}); "
            "give one file, or a folder of one format."
        )
    if not there:
        inside = sorted(p.name for p in path.iterdir())
        raise DataError(
            f"folder {str(path)!r} holds no log ({few(inside) or 'it is empty'}); give "
            f"{_FORMATS}."
        )
    return next(iter(there.values()))


def _is_bag(path: Path) -> bool:
    """Whether it is the folder of a rosbag2."""
    return (path / "metadata.yaml").is_file()


def _read(file: Path, model: LoadedModel | None) -> list[Table]:
    suffix = file.suffix.lower()
    if suffix == ".csv":
        return read_csv(file, model)
    if suffix == ".npz":
        return read_npz(file, model)
    if suffix in _BAGS or file.is_dir():
        # Its decoders take a while to import, which other formats need not wait for.
        from rlco.gap.logs.formats.rosbags import read_rosbag

        return read_rosbag(file)
    return read_bam(file)


def _header_angles(tables: Sequence[Table]) -> str | None:
    """Return the unit of angles that the headers give, where they give one."""
    given = {column.angles for table in tables for column, _ in table.columns}
    units = [unit for unit in given if unit is not None]
    return units[0] if len(units) == 1 else None


def _corrected(log: Log) -> Log:
    timed, notes = at_read_times(log.recordings)
    corrected = [correct_timing(recording) for recording in timed]
    every = [part for one in corrected for part in one.parts]
    notes += [note for one in corrected for note in one.notes]
    parts = tuple(p for p in every if p.rows >= _FEWEST_ROWS or p.pose is not None)
    brief = [p for p in every if p.rows < _FEWEST_ROWS and p.pose is None]
    notes += [
        f"{p.name!r} is left out: it has {p.rows} row{'s'[: p.rows > 1]}."
        for p in brief
    ]
    if not parts:
        raise DataError(f"no part of the log is whole: {few(notes, 2)}")
    return replace(log, recordings=parts, notes=(*log.notes, *_few_notes(notes)))


def _few_notes(notes: Sequence[str], most: int = 12) -> list[str]:
    more = len(notes) - most
    if more <= 0:
        return list(notes)
    like = (
        "One more note like these." if more == 1 else f"{more} more notes like these."
    )
    return [*notes[:most], like]
