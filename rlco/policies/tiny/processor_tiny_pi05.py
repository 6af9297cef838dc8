"""pi0.5's processors with a tokenizer from a folder."""

from __future__ import annotations

from typing import Any

from lerobot.policies.pi05.processor_pi05 import (
    Pi05PrepareStateTokenizerProcessorStep,
)
from lerobot.processor import (
    TokenizerProcessorStep,
    make_default_policy_processor_steps,
    make_policy_processor_pipelines,
)

from rlco.policies.tiny.configuration_tiny_pi05 import TinyPI05Config


def make_tiny_pi05_pre_post_processors(
    config: TinyPI05Config, dataset_stats: Any = None
) -> Any:
    """Return both pipelines, in pi0.5's order."""
    steps = make_default_policy_processor_steps(config, dataset_stats)
    return make_policy_processor_pipelines(
        input_steps=[
            steps.rename_observations,
            steps.add_batch_dim,
            steps.normalize,
            Pi05PrepareStateTokenizerProcessorStep(max_state_dim=config.max_state_dim),
            TokenizerProcessorStep(
                tokenizer_name=config.tokenizer,
                max_length=config.tokenizer_max_length,
                padding_side="right",
                padding="max_length",
            ),
            steps.to_device,
        ],
        output_steps=[steps.unnormalize, steps.to_cpu],
    )
