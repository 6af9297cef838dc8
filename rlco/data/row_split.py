"""How many sim rows a batch holds: error diffusion in whole numbers."""

from __future__ import annotations

from fractions import Fraction


class RowSplit:
    """Splits batches so that the share of sim rows is exact in the long run.

    What a batch cannot split evenly is carried: after any number of whole batches
    the rows of sim are ``floor(ratio * rows)``.

    Args:
        ratio: Share of sim rows in [0, 1], taken as the nearest fraction with a
            denominator up to a billion, so that 0.1 means one tenth.

    Attributes:
        ratio: That fraction.
        carry: Sim rows owed, in units of 1 / ratio.denominator. Less than one row,
            but where ``complete`` had to give a real row too many.

    Example:
        >>> split = RowSplit(0.25)
        >>> [split.take(6) for _ in range(4)]
        [1, 2, 1, 2]
    """

    def __init__(self, ratio: float) -> None:
        self.ratio = Fraction(ratio).limit_denominator(10**9)
        self.carry = 0

    @property
    def least_batch(self) -> int:
        """Rows that a batch needs to hold one of each kind every time."""
        shares = [share for share in (self.ratio, 1 - self.ratio) if share]
        return max(-(-share.denominator // share.numerator) for share in shares)

    def take(self, rows: int) -> int:
        """Return the number of sim rows among the next ``rows``."""
        p, q = self.ratio.as_integer_ratio()
        owed = self.carry + p * rows
        # Debts are paid over several batches where one needs its last row for real.
        n_sim = min(owed // q, rows if p == q else rows - 1)
        self.carry = owed - q * n_sim
        return n_sim

    def give_back(self, rows: int, n_sim: int) -> None:
        """Undo a ``take(rows)`` that returned ``n_sim``."""
        p, q = self.ratio.as_integer_ratio()
        self.carry += q * n_sim - p * rows

    def complete(self, n_sim: int) -> int:
        """Return the number of real rows that go with ``n_sim`` sim rows.

        The fewest that leave sim no row ahead, and at least one where the ratio has
        any; later batches make up for it.
        """
        p, q = self.ratio.as_integer_ratio()
        n_real = -((self.carry + p * n_sim - q * n_sim) // p)
        if p < q:
            n_real = max(n_real, 1)
        self.carry += p * (n_sim + n_real) - q * n_sim
        return n_real
