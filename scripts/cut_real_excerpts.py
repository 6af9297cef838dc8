"""Cut small excerpts of the measured data sets, for tests of a fresh clone.

    uv run scripts/cut_real_excerpts.py ../shared/data/real tests/real_excerpts

Values stay as they were measured; only rows are left out. Where each set comes from,
and its licence, stands in tests/real_excerpts/README.md.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

_PANDA_ROWS = 240  # of 727, at 30 Hz
_TOSSES = (0, 95, 190)
_TOSS_ROWS = 79  # half a second, flight and impact
_SERVO_ROWS = 960  # 4.2 s: torque is switched off after 2 s
_SERVO_STRIDE = 2  # every other row, for the size of the file
_HUMANOID_ROWS = 150  # 5 s


def cut_panda(source: Path, target: Path) -> None:
    """Cut the first rows of the Panda's positions, velocities and torques."""
    lines = (source / "panda_ur10_unisa" / "panda.csv").read_text().splitlines()
    (target / "panda.csv").write_text("\n".join(lines[: 1 + _PANDA_ROWS]) + "\n")


def cut_cube(source: Path, target: Path) -> None:
    """Cut the first rows of three tosses."""
    stored = np.load(source / "cube_tosses" / "cube_tosses.npz")
    ends = np.cumsum(stored["length"])
    starts = ends - stored["length"]
    rows = [stored["data"][starts[t] : starts[t] + _TOSS_ROWS] for t in _TOSSES]
    np.savez_compressed(
        target / "cube_tosses.npz",
        data=np.concatenate(rows),
        length=np.array([len(part) for part in rows]),
        toss_id=stored["toss_id"][list(_TOSSES)],
    )


def cut_servo(source: Path, target: Path) -> None:
    """Cut every other row of a run whose pendulum is lifted and let fall."""
    for path in sorted((source / "bam_xl330" / "raw_xl330").glob("*.json")):
        run = json.loads(path.read_text())
        if run["trajectory"] == "lift_and_drop" and run["kp"] == 400:
            run["entries"] = run["entries"][:_SERVO_ROWS:_SERVO_STRIDE]
            text = json.dumps(run, separators=(",", ":"))
            (target / "xl330_lift_and_drop.json").write_text(text + "\n")
            return
    raise SystemExit(f"{source}: no run lift_and_drop with kp 400")


def cut_humanoid(source: Path, target: Path) -> None:
    """Cut the first rows of one episode, as a LeRobot v2.1 folder."""
    data = Path("data", "chunk-000", "episode_000000.parquet")
    old, new = source / "lerobot_g1", target / "lerobot_g1"
    for folder in (new / data.parent, new / "meta"):
        folder.mkdir(parents=True, exist_ok=True)
    table = pq.read_table(old / data).slice(0, _HUMANOID_ROWS)
    pq.write_table(table, new / data, compression="zstd")
    info = json.loads((old / "meta" / "info.json").read_text())
    info |= {"total_episodes": 1, "total_frames": _HUMANOID_ROWS}
    (new / "meta" / "info.json").write_text(json.dumps(info, indent=1) + "\n")
    first = (old / "meta" / "episodes.jsonl").read_text().splitlines()[0]
    episode = json.loads(first) | {"length": _HUMANOID_ROWS}
    (new / "meta" / "episodes.jsonl").write_text(json.dumps(episode) + "\n")
    tasks = (old / "meta" / "tasks.jsonl").read_text()
    (new / "meta" / "tasks.jsonl").write_text(tasks)


def main(source: Path, target: Path) -> None:
    """Cut all of them."""
    target.mkdir(parents=True, exist_ok=True)
    for cut in (cut_panda, cut_cube, cut_servo, cut_humanoid):
        cut(source, target)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit("usage: cut_real_excerpts.py SOURCE TARGET")
    main(Path(sys.argv[1]), Path(sys.argv[2]))
