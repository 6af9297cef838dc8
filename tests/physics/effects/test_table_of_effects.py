"""The page that lists the library's effects lists all of them, with their numbers."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco

from rlco.physics.effects import EFFECTS

PAGE = Path(__file__).parents[3] / "docs" / "api" / "effects.md"
# It has whatever an effect can act on.
ARM = """
<mujoco><compiler angle="radian"/><worldbody><geom type="plane" size="1 1 .1"/>
<body name="block" pos="0 1 .5"><freejoint/><geom size=".05"/></body>
<body name="upper"><joint name="shoulder" axis="0 1 0"/><geom size=".1"/>
<body name="hand" pos="0 0 .4"><joint name="elbow" axis="0 1 0"/><geom size=".1"/>
</body></body></worldbody>
<actuator><position joint="shoulder" kp="50"/><position joint="elbow" kp="50"/>
</actuator></mujoco>
"""


def test_every_effect_is_listed_with_its_numbers_and_units() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    expected = {}
    for name, effect in EFFECTS.items():
        target = next(iter(effect.targets(model)), None)
        numbers = [(p.name, p.unit) for p in effect.parameters(model, target)]
        expected[name] = numbers, effect.summary
    found = {}
    for line in PAGE.read_text().splitlines():
        cells = [c.replace(r"\|", "|").strip() for c in re.split(r"(?<!\\)\|", line)]
        if len(cells) == 6 and (name := cells[1].strip("`")) in EFFECTS:
            pairs = re.findall(r"`(\w+)`(?: \[([^]]+)\])?", cells[3])
            found[name] = pairs, cells[4]
    assert found == expected
