"""Any task by its name: rlco's own, a user's, or one of robosuite's."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from rlco.errors import RlcoError
from rlco.physics.domain import make_domain
from rlco.physics.robosuite_options import PREFIX, check_one_arm
from rlco.physics.robosuite_tasks import RobosuiteTask, make_plain
from rlco.physics.task import Task, make_task


def named_task(task: str | Task) -> Task | RobosuiteTask:
    """Return what a task's name stands for, or the task itself.

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


def check_domains(task: str, domains: Iterable[str]) -> None:
    """Refuse domains that are not there, or that a task cannot be evaluated in.

    Raises:
        UnknownNameError: There is no such domain.
        RlcoError: The task is one of robosuite's, and has but one.

    Example:
        >>> check_domains("push_cube", ["sim", "stand_in"])
    """
    for domain in domains:
        make_domain(domain)
        if task.startswith(PREFIX) and domain != "sim":
            raise RlcoError(
                f"domain {domain!r} is not supported for {task!r}, one of robosuite's "
                "own tasks; give 'eval_domains=[sim]'."
            )


@cache
def _of_robosuite(name: str) -> RobosuiteTask:
    check_one_arm(name)
    env = make_plain(name)
    try:
        env.reset()
        return RobosuiteTask.of(name, env)
    finally:
        env.close()
