"""A user's model compiled once in a process of its own, where it can do no harm.

A few words of MJCF make a model that fills any memory or compiles for hours, deaf to
Ctrl-C: a height field of 10^10 points, a body replicated 10^8 times.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from rlco.errors import RlcoError
from rlco.files.reading import cut
from rlco.gap.xml_tags import is_understood, tags

#: What a model may take to compile, beyond what MuJoCo takes itself: memory, time of
#: the processor, and time on a machine that is busy. [bytes], [s], [s]
MEMORY, SECONDS, WAIT = 2 * 2**30, 10.0, 60.0
#: Elements of a model that is about as large as its text. What others make of a few
#: words, or read from other files, is tried first.
_PLAIN = frozenset(
    (
        *("mujoco", "mujocoinclude", "compiler", "option", "flag", "statistic"),
        *("default", "worldbody", "body", "inertial", "joint", "freejoint", "geom"),
        *("site", "camera", "light", "frame", "contact", "pair", "exclude"),
        *("equality", "connect", "weld", "tendon", "fixed", "spatial", "actuator"),
        *("motor", "position", "velocity", "intvelocity", "general", "damper"),
        *("cylinder", "sensor", "jointpos", "jointvel", "actuatorfrc", "visual"),
        *("global", "quality", "headlight", "map", "scale", "rgba", "material"),
        *("asset", "robot", "link", "origin", "axis", "limit", "dynamics", "parent"),
        *("child", "visual", "collision", "geometry", "box", "sphere", "mass"),
        *("inertia", "color", "transmission", "type", "hardwareInterface"),
        *("mechanicalReduction",),
    )
)
#: Elements that MuJoCo compiles in a second; its time grows with their square.
_MANY = 1000
#: Attributes whose number is a size, not a property.
_SIZES = re.compile(r"\b(nsample|user|n[a-z]*_?user)\s*=")
_FAILED = 3
_CODE = f"""
import resource, sys
import mujoco
# What is written to: threads reserve addresses that they never use.
pages = int(open("/proc/self/statm").read().split()[5])
most = pages * resource.getpagesize() + int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_DATA, (most, most))
spent = int(resource.getrusage(resource.RUSAGE_SELF).ru_utime)
most = spent + int(sys.argv[3])
resource.setrlimit(resource.RLIMIT_CPU, (most, most))
try:
    mujoco.MjSpec.from_file(sys.argv[1]).compile()
except ValueError as error:
    sys.stdout.buffer.write(str(error).encode("utf-8", "replace"))
    sys.exit({_FAILED})
"""


def try_model(path: Path, source: str) -> None:
    """Compile a model in a process of its own, unless its text bounds its size.

    Args:
        path: Its file.
        source: The text in it.

    Raises:
        RlcoError: It takes more than two gigabytes or ten seconds, or does not compile.
    """
    if is_plain(source):
        return
    memory = MEMORY + 20 * path.stat().st_size
    limits = [str(memory), str(int(SECONDS))]
    command = [sys.executable, "-I", "-c", _CODE, str(path.absolute()), *limits]
    too_large = RlcoError(
        f"model {str(path)!r} takes more than {memory / 2**30:.1f} GB or "
        f"{SECONDS:g} s to compile; make it smaller: a replicate, a height field, a "
        "composite or a mesh in it is too large."
    )
    try:
        # Elsewhere: MuJoCo leaves its warnings where it is.
        with TemporaryDirectory() as elsewhere:
            done = subprocess.run(
                command,
                capture_output=True,
                timeout=WAIT,
                check=False,
                cwd=elsewhere,
            )
    except subprocess.TimeoutExpired:
        raise too_large from None
    said = done.stdout.decode("utf-8", "replace")
    if done.returncode == _FAILED and "memory" not in said and "alloc" not in said:
        raise does_not_compile(path, said)
    if done.returncode != 0:
        raise too_large


def is_plain(source: str) -> bool:
    """Return whether a model is small, as large as its text, and reads no other file.

    Example:
        >>> is_plain("<mujoco><worldbody><body/></worldbody></mujoco>")
        True
        >>> is_plain("<mujoco><asset><mesh file='arm.stl'/></asset></mujoco>")
        False
    """
    names = [tag.name for tag in tags(source) if not tag.closes]
    return (
        is_understood(source)
        and len(names) <= _MANY
        and _PLAIN.issuperset(names)
        and not _SIZES.search(source)
    )


def does_not_compile(path: Path, said: str) -> RlcoError:
    """Return the error for a model that MuJoCo refuses, with its words on one line."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    quoted = cut("; ".join(lines), 600)
    return RlcoError(f"model {str(path)!r} does not compile; MuJoCo says: {quoted}")
