"""Recorded images are those that the environment shows in the same states."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from rlco.data import film_demonstrations
from rlco.envs import make_env
from rlco.errors import UnknownNameError
from rlco.keys import ACTION, IMAGE, STATE
from rlco.physics.spec.domain import make_domain
from rlco.physics.tasks.demonstrate import demonstrate
from rlco.physics.tasks.make_task import make_task

pytestmark = pytest.mark.slow

TASK, SIM = make_task("push_cube"), make_domain("sim")
SIZE = (64, 64)


@pytest.mark.usefixtures("rendering")
def test_pictures_are_the_environments_at_each_control_step() -> None:
    # Noise enough that the first episodes of this seed fail and are passed over.
    options = {"episodes": 1, "seed": 2, "noise": 1.0}
    plain = demonstrate(TASK, SIM, num_envs=4, **options)
    filmed = film_demonstrations(
        TASK, SIM, camera="agentview", image_size=SIZE, **options
    )
    starts = make_env(TASK, num_envs=4, seed=2).reset()[STATE]
    env = make_env(TASK, image_size=SIZE, seed=2)
    episodes = []
    for (one, images), other in zip(filmed, plain, strict=True):
        np.testing.assert_array_equal(one.action, other.action)
        np.testing.assert_array_equal(one.state, other.state)
        assert images.shape == (len(one.action), 3, *SIZE)
        # In sim the robot's state is told without noise: it says which episode it is.
        first = torch.from_numpy(one.state[0]).float()
        ((episode,),) = (starts == first).all(-1).nonzero().tolist()
        episodes.append(episode)
        env.start_at(episode)
        td = env.reset()
        for step in range(6):
            np.testing.assert_array_equal(images[step], td[IMAGE][0].numpy())
            action = torch.from_numpy(one.action[step]).float().view(1, 1, 7)
            td = env.step(TensorDict({ACTION: action}, [1]))["next"]
        assert not np.array_equal(images[0], images[-1])
    assert episodes != [0]
    env.close()


@pytest.mark.usefixtures("rendering")
def test_an_unknown_camera_is_refused_before_anything_is_played() -> None:
    with pytest.raises(UnknownNameError, match=r"'agentviw' .*'agentview'"):
        film_demonstrations(
            TASK, SIM, camera="agentviw", image_size=SIZE, episodes=1, seed=0
        )
