"""Instructions as OpenVLA's prompts."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import torch
from transformers import PreTrainedTokenizerFast

from rlco.errors import CheckpointError, ConfigError
from rlco.files.reading import check_kind
from rlco.policies.vla.openvla.config import OpenVLAConfig

PROMPT = "In: What action should the robot take to {}?\nOut:"


def prompt_tokens(
    config: OpenVLAConfig,
    instructions: Sequence[str],
    tokenizer: str | os.PathLike[str],
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return every instruction's prompt, tokenised once for all.

    Args:
        config: the checkpoint's.
        instructions: texts in the order of their ids.
        tokenizer: folder with Llama's tokenizer; the published checkpoint's own.

    Returns:
        Tokens int64 and mask bool, each (instructions, L): the first token, then
        padding, then the rest, so that all prompts end at the same place.

    Raises:
        ConfigError: no instruction.
        CheckpointError: no tokenizer there, or one of another vocabulary.
    """
    if not instructions:
        raise ConfigError(["instructions=[] leaves the policy without a text"])
    advice = "give the folder of Llama's tokenizer, whole"
    check_kind(*Path(tokenizer).glob("*"), advice=advice, error=CheckpointError)
    try:
        # Not by AutoTokenizer, which asks config.json for a type that it knows.
        read = PreTrainedTokenizerFast.from_pretrained(
            Path(tokenizer), local_files_only=True
        )
    except (OSError, ValueError) as error:
        raise CheckpointError(
            f"{str(tokenizer)!r} holds no tokenizer; give the folder of Llama's by "
            "tokenizer=FOLDER (tokenizer.json and tokenizer_config.json, as "
            "openvla-7b has them)."
        ) from error
    rows = [read(PROMPT.format(text.lower())).input_ids for text in instructions]
    highest = max(max(row) for row in rows)
    if highest >= config.first_action_token:
        raise CheckpointError(
            f"the tokenizer {str(tokenizer)!r} gives token {highest}, but words end "
            f"at {config.first_action_token} here; give the checkpoint's own tokenizer."
        )
    rows = [
        row + [config.empty_token] * (row[-1] != config.empty_token) for row in rows
    ]
    length = max(map(len, rows))
    tokens = torch.full((len(rows), length), config.pad_token)
    mask = torch.zeros(len(rows), length, dtype=torch.bool)
    for i, row in enumerate(rows):
        tokens[i, 0], mask[i, 0] = row[0], True
        rest = len(row) - 1
        tokens[i, length - rest :] = torch.tensor(row[1:])
        mask[i, length - rest :] = True
    return tokens, mask
