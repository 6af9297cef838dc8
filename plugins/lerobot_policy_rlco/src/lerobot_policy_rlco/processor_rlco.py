"""LeRobot's processors around a policy that normalises by itself."""

from __future__ import annotations

from typing import Any

from lerobot.processor import (
    make_default_policy_processor_steps,
    make_policy_processor_pipelines,
)

from lerobot_policy_rlco.configuration_rlco import RlcoConfig


def make_rlco_pre_post_processors(config: RlcoConfig, dataset_stats: Any = None) -> Any:
    """Return pipelines that add the batch axis, rename and move, and change nothing."""
    steps = make_default_policy_processor_steps(config, dataset_stats)
    return make_policy_processor_pipelines(
        input_steps=[
            steps.rename_observations,
            steps.add_batch_dim,
            steps.to_device,
            steps.normalize,
        ],
        output_steps=[steps.unnormalize, steps.to_cpu],
    )
