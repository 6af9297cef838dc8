"""A policy's units against an environment's: degrees stay degrees, or are refused."""

from __future__ import annotations

import logging
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from torchrl.envs.utils import check_env_specs, step_mdp

from rlco import keys
from rlco.collectors import RolloutCollector
from rlco.envs import check_action_units, from_gymnasium, make_env
from rlco.errors import ConfigError, RlcoError
from rlco.evaluation import evaluate
from rlco.policies import GaussianPolicy


class DegreesArm(gymnasium.Env[Any, Any]):
    """Two joints that are where they were commanded to be; all in degrees."""

    def __init__(self, reach: float = 180.0) -> None:
        self.observation_space: Any = spaces.Box(-1e3, 1e3, (2,), np.float32)
        self.action_space = spaces.Box(-reach, reach, (2,), np.float32)
        self.steps = 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        """Start at zero."""
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(2, np.float32), {}

    def step(self, action: Any) -> Any:
        """Move."""
        self.steps += 1
        info = {"is_success": False}
        return np.asarray(action, np.float32), 0.0, False, self.steps >= 8, info


def arm(**options: Any) -> Any:
    return from_gymnasium(DegreesArm, chunk=2, **options)


def moved(env: Any, *angles: float) -> list[float]:
    """Return where a chunk of the same command leaves the joints."""
    td = env.reset()
    action = torch.tensor(angles).expand(1, 2, 2)
    seen: torch.Tensor = env.step(td.set("action", action))["next", "observation"][
        "state"
    ]
    return seen[0].tolist()


def policy(limit: float | None) -> GaussianPolicy:
    return GaussianPolicy(2, chunk=2, action_size=2, action_limit=limit, hidden=(4,))


def test_degrees_arrive_as_degrees() -> None:
    env = arm(scale_actions=False)
    assert moved(env, 2.9, -170.0) == pytest.approx([2.9, -170.0])


def test_actions_in_the_environments_own_units_have_its_bounds() -> None:
    env = from_gymnasium(DegreesArm, chunk=3, num_envs=2, scale_actions=False)
    check_env_specs(env)
    spec = env.action_spec
    assert spec.shape == (2, 3, 2)
    assert (float(spec.low.min()), float(spec.high.max())) == (-180.0, 180.0)
    drawn = env.rand_action(env.reset())["action"]
    assert drawn.abs().max() > 1.0


def test_scaled_actions_still_cover_the_range() -> None:
    env = arm()
    assert moved(env, 0.5, -1.0) == [90.0, -180.0]
    assert float(env.action_spec.high.max()) == 1.0


def test_angles_that_would_be_scaled_are_warned_of_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    env = arm()
    with caplog.at_level(logging.WARNING, "rlco"):
        moved(env, 0.3, 0.9)
        assert not caplog.records
        moved(env, 0.3, 2.9)
        moved(env, 0.3, 2.9)
    (record,) = caplog.records
    said = record.getMessage()
    assert "from 0.3 to 2.9" in said
    assert "-180 to 180" in said
    assert "scale_actions=False" in said


def test_angles_far_beyond_one_are_refused() -> None:
    with pytest.raises(RlcoError, match=r"from -57 to 3, .*scale_actions=False"):
        moved(arm(), 3.0, -57.0)


def test_bounds_are_needed_only_to_scale() -> None:
    def unbounded() -> DegreesArm:
        return DegreesArm(np.inf)

    with pytest.raises(RlcoError, match=r"without finite bounds.*scale_actions=False"):
        from_gymnasium(unbounded)
    env = from_gymnasium(unbounded, chunk=2, scale_actions=False)
    assert moved(env, 400.0, -2.5) == [400.0, -2.5]


@pytest.mark.parametrize("num_envs", [1, 3])
def test_a_policy_in_degrees_is_refused_where_actions_are_scaled(num_envs: int) -> None:
    with pytest.raises(RlcoError, match=r"action_limit=None.*scale_actions=False"):
        check_action_units(policy(None), arm(num_envs=num_envs))
    check_action_units(policy(None), arm(scale_actions=False, num_envs=num_envs))


def test_a_policy_of_scaled_actions_is_refused_where_degrees_are_taken() -> None:
    with pytest.raises(RlcoError, match=r"-180 to 180; .*scale_actions=True"):
        check_action_units(policy(1.0), arm(scale_actions=False))
    check_action_units(policy(1.0), arm())


def test_a_range_of_one_is_the_environments_own() -> None:
    def unit() -> DegreesArm:
        return DegreesArm(1.0)

    for scale_actions in (True, False):
        env = from_gymnasium(unit, scale_actions=scale_actions)
        check_action_units(policy(None), env)
        check_action_units(policy(1.0), env)


def test_rlcos_own_environments_take_no_policy_in_other_units() -> None:
    env = make_env("push_cube", num_envs=2, chunk=2, horizon=4)
    own = GaussianPolicy(7, chunk=2, action_limit=None, hidden=(4,))
    with pytest.raises(RlcoError, match="action_limit=None"):
        evaluate(own, env, 2)
    with pytest.raises(RlcoError, match="action_limit=None"):
        RolloutCollector(env, own, advantage="mc", group_size=2)


def test_evaluate_says_which_environments_it_plays() -> None:
    with pytest.raises(ConfigError, match=r"make_env, and SerialEnv cannot"):
        evaluate(policy(1.0), arm(), 2)
    with pytest.raises(ConfigError, match=r"make_env, and SerialEnv has no"):
        RolloutCollector(arm(), policy(1.0), advantage="mc")


def test_a_rollout_of_a_policy_in_degrees_stays_within_the_data() -> None:
    one = policy(None)
    one.set_normalization(action=([-90.0, 10.0], [-30.0, 20.0]))
    env = arm(scale_actions=False)
    td = one(step_mdp(env.step(env.rand_action(env.reset()))))
    wanted = td["action"][0, -1].tolist()
    reached = env.step(td)["next", keys.STATE][0].tolist()
    assert reached == pytest.approx(wanted)
