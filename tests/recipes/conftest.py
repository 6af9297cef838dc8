"""Recipes are scripts: their folder is put on the path, and their inputs made once."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from recipe_cases import RL_CO, SFT, Assets, start


@pytest.fixture(scope="session")
def assets(tmp_path_factory: pytest.TempPathFactory) -> Assets:
    """Record two small data sets, then run both stages on them."""
    root = tmp_path_factory.mktemp("recipes")
    made = Assets(root / "sim", root / "real", root / "sft", root / "rl_co")
    for domain, folder in (("sim", made.sim), ("stand_in", made.real)):
        start("record_demos", f"domain={domain}", "episodes=2", f"out={folder}")
    start("sft", *demos(made), f"out={made.sft}", *SFT)
    start("rl_co", *stage_one(made), f"out={made.rl_co}", *RL_CO)
    return made


def demos(assets: Assets) -> list[str]:
    return [f"sim_demos={assets.sim}", f"real_demos={assets.real}"]


def stage_one(assets: Assets) -> list[str]:
    return [
        f"policy={assets.sft / 'policy'}",
        f"real_demos={assets.real}",
        f"heldout_demos={assets.real}",
    ]


@pytest.fixture(scope="session")
def inputs(assets: Assets) -> dict[str, list[str]]:
    """Each training recipe's input and tiny settings, all but its output."""
    return {
        "sft": [*demos(assets), *SFT],
        "rl_co": [*stage_one(assets), *RL_CO],
    }


@pytest.fixture(autouse=True, scope="module")
def few_scenes_held_out() -> Iterator[None]:
    """Measure a pretrained encoder's error on 16 scenes: to draw 400 takes longer."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rlco.training.pretraining.HELD_OUT", 16)
        yield
