"""Domains: differences between the simulator and the place where a policy will run.

A `Domain` is data: physical effects, sensor errors and a look. ``sim`` is the
simulator that a user would build. ``stand_in`` is a second simulator that takes the
robot's part where no robot is available: no measurement in it is from a robot. Its
parameters were chosen from typical real set-ups before any policy was trained, and are
not tuned to results. ``locked`` is a third simulator with other values of the same
kinds, for final tables alone: nothing is chosen by success in it. The gap workflow
writes a domain file.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from math import prod
from pathlib import Path
from typing import Any, Literal

from rlco.errors import DataError, RlcoError, UnknownNameError
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.apply import library_effect
from rlco.physics.effects.corrected_model import Given, given_effects
from rlco.physics.effects.effects_file import read_effects, write_effects
from rlco.physics.spec.look import Look
from rlco.physics.spec.look_file import content_of_look, look_of
from rlco.physics.spec.look_ranges import LookRanges
from rlco.physics.spec.looks import (
    LOCKED_LOOK,
    LOOKS,
    RANDOM,
    STAND_IN_LOOK,
    GivenLook,
    make_look,
)
from rlco.physics.spec.own import of_module
from rlco.physics.spec.robot import PANDA
from rlco.physics.spec.sample import Sample, sample_of
from rlco.physics.spec.sample import content_of as sample_content
from rlco.physics.spec.sensors import Sensors, content_of, sensors_of


@dataclass(frozen=True)
class Domain:
    """All differences between one place to run a policy and another.

    Attributes:
        name: The name under which results are filed.
        effects: Physical effects. Those of `rlco.physics.effects.scene` are read by a
            task while it is built; all others act on its model, commands and encoders.
            If two set the same parameter, the later one counts.
        sensors: Sensor errors.
        look: How its images look; `LookRanges` draw a look for each episode.
        sample: Parameter sets that are about as believable as the effects' own numbers;
            None: none. Episodes draw them where they are asked to, see `drawing`.

    Raises:
        RlcoError: If an effect is unknown, or no task can have it.

    Example:
        >>> heavy = AppliedEffect("scene_mass", None, {"factor": 1.4})
        >>> Domain("heavy", (heavy,)).mass_scale
        1.4
    """

    name: str
    effects: tuple[AppliedEffect, ...] = ()
    sensors: Sensors = field(default_factory=Sensors)
    look: Look | LookRanges = field(default_factory=Look)
    sample: Sample | None = None

    def __post_init__(self) -> None:
        file = given_effects(self.effects)
        object.__setattr__(self, "effects", file.renamed() if file else ())

    @property
    def friction_scale(self) -> float:
        """Factor of the sliding friction of the task's objects, table and handles."""
        return self._factor("scene_friction")

    @property
    def mass_scale(self) -> float:
        """Factor of the masses of objects and of what fixtures move."""
        return self._factor("scene_mass")

    @property
    def fixture_friction_scale(self) -> float:
        """Factor of the friction of fixtures' joints, such as a drawer's runners."""
        return self._factor("fixture_friction")

    @property
    def stiffness_scale(self) -> float:
        """Factor of the stiffness of the arm's controller."""
        return self._factor("controller_stiffness")

    @property
    def model_effects(self) -> tuple[AppliedEffect, ...]:
        """The effects that act on a model, its commands and its encoders."""
        return tuple(e for e in self.effects if not library_effect(e.name).of_task)

    @property
    def model_sample(self) -> Sample | None:
        """The parameter sets of `model_effects`."""
        if self.sample is None:
            return None
        kept = [
            index
            for index, effect in enumerate(self.effects)
            if not library_effect(effect.name).of_task
        ]
        return self.sample.moved({index: place for place, index in enumerate(kept)})

    def _factor(self, name: str) -> float:
        factors = [e.parameters["factor"] for e in self.effects if e.name == name]
        return prod(factors, start=1.0)


GivenDomain = str | Path | Domain
#: What an episode's effects have: ``posterior``, one of the domain's parameter sets;
#: None, their own numbers.
SampleKind = Literal["posterior"] | None
SAMPLE_KINDS = ("posterior",)


def with_effects(domain: Domain, effects: Given) -> Domain:
    """Return a domain with more effects.

    Args:
        domain: The domain.
        effects: A list of effects, or the path of an ``effects.yaml``.

    Raises:
        RlcoError: If they cannot be read, or no task can have one of them.
    """
    file = given_effects(effects)
    if file is None:
        return domain
    return replace(domain, effects=(*domain.effects, *file.renamed()))


def with_look(domain: Domain, look: GivenLook | None) -> Domain:
    """Return a domain with another look; None: its own.

    Args:
        domain: The domain.
        look: See `rlco.physics.spec.looks.make_look`. Ranges of looks are drawn around
            where the domain's own look has its cameras, unless they say around what.

    Raises:
        UnknownNameError: If there is no look of that name.
        RlcoError: If a camera drawn around the domain's would be refused.

    Example:
        >>> import numpy as np
        >>> from rlco.physics.spec.look import View
        >>> near = Look(cameras={"agentview": View(shift=(0.0, 0.0, -0.4))})
        >>> ranges = with_look(Domain("near", look=near), "random").look
        >>> ranges.draw(np.random.default_rng(0)).cameras["agentview"].shift[2] < -0.3
        True
    """
    if look is None:
        return domain
    found = make_look(look)
    if isinstance(found, LookRanges) and isinstance(domain.look, Look):
        found = replace(found, around=found.around or domain.look.cameras)
    return replace(domain, look=found)


def _everywhere(
    name: str, joints: tuple[str, ...], **numbers: float
) -> tuple[AppliedEffect, ...]:
    return tuple(AppliedEffect(name, joint, numbers) for joint in joints)


def _scene(name: str, factor: float) -> AppliedEffect:
    return AppliedEffect(name, None, {"factor": factor})


SIM = Domain("sim")

STAND_IN = Domain(
    "stand_in",
    (
        # Published friction of wood or plastic on table tops varies by a third.
        _scene("scene_friction", 0.7),
        # The same 5 cm cube in beech instead of pine.
        _scene("scene_mass", 1.4),
        # Identified Coulomb friction of Panda joints is 0.2 to 0.5 N m.
        *_everywhere("coulomb_friction", PANDA.joints, frictionloss=0.3),
        *_everywhere("viscous_damping", PANDA.joints, damping=0.5),
        # Real impedance controllers are softer than simulated ones, for safety.
        _scene("controller_stiffness", 0.8),
        # 30 to 150 ms between command and motion is common; this is 50 ms.
        AppliedEffect("command_delay", None, {"delay": 0.05}),
        # Dry wooden runners, slightly swollen: twice the friction of a waxed pair.
        _scene("fixture_friction", 2.0),
    ),
    Sensors(
        # Extrinsics matched by eye, as in the paper's cousin scenes, not calibrated.
        camera_yaw=0.14,  # 8 degrees
        camera_shift=(0.025, -0.015),
        # Depth noise of a consumer RGB-D camera at about 1 m.
        object_noise=0.003,
        state_noise=0.0005,
        # A fingertip other than the modelled one, and an uncalibrated gripper zero.
        tool_offset=0.006,
        gripper_offset=0.0015,
    ),
    STAND_IN_LOOK,
)

# Another robot than `STAND_IN`: the same kinds of effects and errors, all with other
# values, on the other side of `sim` where there is one. Each is a value that a real
# set-up can have, fixed before any policy was evaluated here; never tune them, nor
# anything else by success here.
LOCKED = Domain(
    "locked",
    (
        # The other end of the same third: a painted table top.
        _scene("scene_friction", 1.3),
        # The same 5 cm cube in polyethylene, 0.95 g/cm3 instead of pine's 0.48.
        _scene("scene_mass", 2.0),
        # The upper end of what was identified on Panda joints.
        *_everywhere("coulomb_friction", PANDA.joints, frictionloss=0.5),
        *_everywhere("viscous_damping", PANDA.joints, damping=0.8),
        # Softer again, as where people stand next to the arm.
        _scene("controller_stiffness", 0.7),
        # 100 ms: two control steps, within the common 30 to 150 ms.
        AppliedEffect("command_delay", None, {"delay": 0.1}),
        # Waxed runners instead of swollen ones.
        _scene("fixture_friction", 0.6),
    ),
    Sensors(
        # Also matched by eye, a little worse, and to the other side.
        camera_yaw=-0.2,  # 11 degrees
        camera_shift=(-0.02, 0.03),
        # The same camera from 1.2 m: depth noise grows with the squared distance.
        object_noise=0.0045,
        state_noise=0.001,
        # A fingertip shorter than the modelled one, a zero that is off the other way.
        tool_offset=-0.004,
        gripper_offset=-0.001,
    ),
    LOCKED_LOOK,
)

DOMAINS = {domain.name: domain for domain in (SIM, STAND_IN, LOCKED)}
#: Domains for final evaluations alone: no policy is trained in them.
FINAL_DOMAINS = (LOCKED.name,)


def make_domain(domain: GivenDomain) -> Domain:
    """Return the domain of that name or file; a `Domain` is returned as it is.

    Args:
        domain: ``sim``, ``stand_in``, ``locked``, the path of a domain file, such as
            the ``effects.yaml`` that the gap workflow writes, or ``MODULE:NAME`` of a
            `Domain` in a module of yours that Python finds.

    Raises:
        UnknownNameError: If there is no domain of that name, or an effect is unknown.
        DataError: If the file cannot be read.
        RlcoError: If no task can have one of its effects, or the module cannot be
            imported, or holds no such domain.

    Example:
        >>> make_domain("stand_in").friction_scale
        0.7
    """
    if isinstance(domain, Domain):
        return domain
    if domain in DOMAINS:
        return DOMAINS[str(domain)]
    path = Path(domain)
    if isinstance(domain, Path) or path.suffix in (".yaml", ".yml") or path.exists():
        return read_domain(path)
    if os.sep in domain:
        return read_domain(path)
    if ":" in domain:
        return _own_domain(domain)
    known = [*sorted(DOMAINS), "the path of a domain's .yaml", "MODULE:NAME of yours"]
    raise UnknownNameError("domain", domain, known)


def drawing(domain: Domain, sample: SampleKind) -> Domain:
    """Return a domain whose episodes draw their effects' numbers, or do not.

    Args:
        domain: The domain.
        sample: ``posterior``: each episode draws one of the domain's parameter sets.
            None: all have the effects' own numbers.

    Raises:
        UnknownNameError: If there is no such kind.
        RlcoError: If the domain has no parameter sets to draw from.

    Example:
        >>> drawing(SIM, "posterior")
        Traceback (most recent call last):
        ...
        rlco.errors.RlcoError: sample='posterior' draws from parameter sets, but \
domain 'sim' has none; give an effects.yaml for which find_gap named effects, or leave \
it out.
    """
    if sample is None:
        return replace(domain, sample=None)
    if sample not in SAMPLE_KINDS:
        raise UnknownNameError("sample", str(sample), SAMPLE_KINDS)
    if domain.sample is None:
        raise RlcoError(
            f"sample={sample!r} draws from parameter sets, but domain {domain.name!r} "
            "has none; give an effects.yaml for which find_gap named effects, or leave "
            "it out."
        )
    return domain


def _own_domain(text: str) -> Domain:
    found = of_module(text, Domain)
    if DOMAINS.get(found.name, found) != found:
        raise RlcoError(
            f"domain {text!r} would be filed under {found.name!r}, the name of one of "
            "rlco's own domains; give it another name=."
        )
    return found


def read_domain(path: str | Path) -> Domain:
    """Return the domain that a file describes, named by the file's stem.

    Sensors and a look missing in the file are those of ``sim``.

    Raises:
        DataError: If the file cannot be read, has another form, or has the name of one
            of rlco's own domains.
        RlcoError: If an effect is unknown, or no task can have it.
    """
    name = Path(path).stem
    if name in DOMAINS:
        raise DataError(
            f"domain file {str(path)!r} would be filed under {name!r}, the name of one "
            "of rlco's own domains; rename it."
        )
    file = read_effects(path)
    sensors = sensors_of(file.sensors or {}, repr(str(path)))
    look: Look | LookRanges = Look()
    if isinstance(file.look, str):
        look = make_look(file.look)
    elif file.look is not None:
        look = look_of(file.look, f"the look of {str(path)!r}")
    sample = None
    if file.sample is not None:
        sample = sample_of(file.sample, file.effects, repr(str(path)))
    return Domain(name, file.renamed(), sensors, look, sample)


def write_domain(path: str | Path, domain: Domain) -> None:
    """Write a domain's effects, sensors, look and sample; the file's stem is its name.

    Raises:
        RlcoError: If its look is of ranges of yours, which a file cannot hold.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "robot.yaml"
        >>> write_domain(path, STAND_IN)
        >>> make_domain(path) == replace(STAND_IN, name="robot")
        True
    """
    sensors = None if domain.sensors == Sensors() else content_of(domain.sensors)
    look: dict[str, Any] | str | None = None
    if isinstance(domain.look, LookRanges):
        if domain.look != LOOKS[RANDOM]:
            raise RlcoError(
                f"the look of domain {domain.name!r} is of ranges of your own, which a "
                f"file cannot hold; give look={RANDOM!r}, or MODULE:NAME of the domain."
            )
        look = RANDOM
    elif domain.look != Look():
        look = content_of_look(domain.look)
    sample = None
    if domain.sample is not None:
        sample = sample_content(domain.sample, domain.effects)
    write_effects(path, domain.effects, sensors=sensors, look=look, sample=sample)
