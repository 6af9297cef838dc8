"""A word-level tokenizer in the files that transformers reads."""

from __future__ import annotations

import os
from collections.abc import Sequence

from tokenizers import Regex, Tokenizer
from tokenizers.models import WordLevel
from tokenizers.pre_tokenizers import Split
from tokenizers.processors import TemplateProcessing
from transformers import PreTrainedTokenizerFast

PAD, BOS, UNKNOWN = "<pad>", "<s>", "<unk>"
#: Words of the prompts, and of rlco's own instructions.
WORDS = (
    "in out what action should the robot take to task state "
    "push pick up place put open close and onto its mark blue red green cube drawer "
    "goal top middle bottom plate it on in of a"
)


def make_tokenizer(
    *, special: dict[str, str] | None = None, begin: bool = False
) -> PreTrainedTokenizerFast:
    """Return a tokenizer that knows a few words, the numbers 0 to 255 and -1.

    Args:
        special: tokens that the model asks for by name, ``{"image_token": "<image>"}``.
        begin: whether every text starts with ``<s>``.

    Example:
        >>> make_tokenizer(begin=True)("push the cube.").input_ids[0]
        1
    """
    named = special or {}
    words = [PAD, BOS, UNKNOWN, *named.values(), *dict.fromkeys(WORDS.split())]
    words += [",", ":", ";", ".", "?", "\n", *(str(n) for n in range(-1, 256))]
    tokenizer = Tokenizer(
        WordLevel({word: i for i, word in enumerate(words)}, unk_token=UNKNOWN)
    )
    tokenizer.pre_tokenizer = Split(
        Regex(r"-?\d+|[A-Za-z]+|[^\sA-Za-z]|\n"), "removed", True
    )
    if begin:
        tokenizer.post_processor = TemplateProcessing(
            single=f"{BOS} $A", special_tokens=[(BOS, 1)]
        )
    return PreTrainedTokenizerFast(
        tokenizer_object=tokenizer,
        pad_token=PAD,
        bos_token=BOS,
        unk_token=UNKNOWN,
        extra_special_tokens=named,
    )


def write_tokenizer(
    folder: str | os.PathLike[str],
    *,
    special: Sequence[tuple[str, str]] = (),
    begin: bool = False,
) -> None:
    """Write it as a folder that ``AutoTokenizer.from_pretrained`` reads offline."""
    make_tokenizer(special=dict(special), begin=begin).save_pretrained(folder)
