"""The share of sim rows is exact in whole numbers."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rlco.data.row_split import RowSplit

ratios = st.fractions(0, 1, max_denominator=1000)


@given(ratio=ratios, extra=st.lists(st.integers(0, 5000), min_size=1, max_size=50))
def test_sim_rows_are_the_floor_of_their_share_after_any_batches(
    ratio: Fraction, extra: list[int]
) -> None:
    split = RowSplit(float(ratio))
    assert split.ratio == ratio
    batches = [split.least_batch + rows for rows in extra]
    n_sim = sum(split.take(rows) for rows in batches)
    assert n_sim == int(ratio * sum(batches))


@given(ratio=ratios.filter(lambda r: 0 < r < 1), batches=st.integers(1, 60))
def test_least_batch_always_holds_one_row_of_each(
    ratio: Fraction, batches: int
) -> None:
    split = RowSplit(float(ratio))
    rows = split.least_batch
    assert all(0 < split.take(rows) < rows for _ in range(batches))
    # Of one row fewer some batch has less than one row of a kind on average.
    assert (rows - 1) * min(ratio, 1 - ratio) < 1


@given(
    ratio=ratios.filter(lambda r: 0 < r < 1),
    sizes=st.lists(st.integers(1, 400), min_size=1, max_size=20),
)
def test_completed_batches_get_the_fewest_real_rows_that_keep_the_share(
    ratio: Fraction, sizes: list[int]
) -> None:
    split = RowSplit(float(ratio))
    total = n_sims = 0
    for n_sim in sizes:
        n_real = split.complete(n_sim)
        total, n_sims = total + n_sim + n_real, n_sims + n_sim
        owed = ratio * total - n_sims
        assert Fraction(split.carry, split.ratio.denominator) == owed
        assert owed >= 0
        # One real row fewer would put sim ahead, or leave none.
        assert owed - ratio < 0 or n_real == 1


@given(ratio=ratios.filter(lambda r: 0 < r < 1))
def test_forced_real_rows_are_made_up_for(ratio: Fraction) -> None:
    split = RowSplit(float(ratio))
    for _ in range(10):
        split.complete(1)
    # At most 10 rows are owed; this batch has room for them beside its own share.
    rows = 12 * split.least_batch
    split.take(rows)
    assert split.carry < split.ratio.denominator


def test_ratio_one_has_no_real_rows() -> None:
    split = RowSplit(1.0)
    assert split.take(7) == 7
    assert split.complete(3) == 0


def test_give_back_undoes_a_take() -> None:
    split = RowSplit(0.3)
    split.take(5)
    carry = split.carry
    split.give_back(9, split.take(9))
    assert split.carry == carry


# 0.1 is not one tenth in binary: floating sums of it drift, whole numbers do not.
@pytest.mark.parametrize(("ratio", "rows"), [(0.1, 10), (0.7, 10), (0.8, 320)])
def test_shares_that_divide_evenly_are_the_same_in_every_batch(
    ratio: float, rows: int
) -> None:
    split = RowSplit(ratio)
    assert {split.take(rows) for _ in range(10_000)} == {round(ratio * rows)}
