"""Any task by its name: rlco's own, a user's, or one of robosuite's."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from rlco.errors import RlcoError
from rlco.physics.effects.effects_file import EffectsFile
from rlco.physics.robosuite.faster.release import release
from rlco.physics.robosuite.options import PREFIX, check_one_arm
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.robosuite.tasks import RobosuiteTask, make_plain
from rlco.physics.spec.domain import DOMAINS, Domain, GivenDomain, make_domain
from rlco.physics.spec.sensors import Sensors
from rlco.physics.spec.task import Task
from rlco.physics.tasks.make_task import make_task


def named_task(task: str | Task) -> Task | RobosuiteTask:
    """Return the task of a name, or the task itself.

    Args:
        task: ``push_cube``, ``MODULE:NAME`` or ``robosuite:Lift``.

    Raises:
        UnknownNameError: If there is no such task.
        RlcoError: If it is one of robosuite's with more than one arm.

    Example:
        >>> named_task("robosuite:Lift").instructions
        ('lift the cube',)
    """
    if isinstance(task, str) and task.startswith(PREFIX):
        return _of_robosuite(task.removeprefix(PREFIX))
    return make_task(task)


def training_horizon(task: str | Task, horizon: int | None = None) -> int:
    """Return the length of a training episode in control steps.

    Args:
        task: A task or its name, see `named_task`.
        horizon: The length where it is given; None: the task's own.

    Example:
        >>> training_horizon("push_cube"), training_horizon("push_cube", 20)
        (64, 20)
    """
    known = named_task(task)
    return horizon or known.training_horizon or known.horizon


def check_domains(task: str, domains: Iterable[GivenDomain]) -> list[Domain]:
    """Return domains by their names or files, and refuse unsupported ones.

    For a file the task's model is compiled once, which reveals an effect that cannot be
    applied.

    Raises:
        UnknownNameError: If there is no such domain.
        RlcoError: If a file cannot be read, two would be filed under one name, or the
            task does not support a domain.

    Example:
        >>> [domain.name for domain in check_domains("push_cube", ["sim", "stand_in"])]
        ['sim', 'stand_in']
    """
    found: dict[str, Domain] = {}
    for given in domains:
        domain = make_domain(given)
        if found.setdefault(domain.name, domain) != domain:
            raise RlcoError(
                f"domain {str(given)!r} would be filed under {domain.name!r}, as "
                "another one is; rename one of the two files."
            )
    for domain in found.values():
        if task.startswith(PREFIX):
            check_robosuite_domain(task, domain)
        if domain.model_effects and domain.name not in DOMAINS:
            _compile(task, domain)
    return list(found.values())


def check_robosuite_domain(task: str, domain: Domain) -> None:
    """Refuse a domain that one of robosuite's own tasks does not support.

    Raises:
        RlcoError: If it has sensor errors, or effects that only rlco's own tasks read.
    """
    if domain.sensors != Sensors() or domain.model_effects != domain.effects:
        raise RlcoError(
            f"domain={domain.name!r} is not supported for {task!r}, one of robosuite's "
            "own tasks, which have no sensor errors and scenes of their own; give sim "
            "(in a recipe 'eval_domains=[sim]'), or a file with effects on the model."
        )


def _compile(task: str, domain: Domain) -> None:
    if task.startswith(PREFIX):
        effects = EffectsFile(domain.effects)
        release(make_plain(task.removeprefix(PREFIX), effects=effects))
    else:
        Tabletop(make_task(task), domain).close()


@cache
def _of_robosuite(name: str) -> RobosuiteTask:
    check_one_arm(name)
    env = make_plain(name)
    try:
        env.reset()
        return RobosuiteTask.of(name, env)
    finally:
        release(env)
