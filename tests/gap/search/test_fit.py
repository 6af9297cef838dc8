"""Fits of many numbers at once, on residuals whose best numbers are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from small_problems import arm_problem

from rlco.gap.compare.problem import Candidate
from rlco.gap.logs.log import Array
from rlco.gap.search.fit import fit, library_of, linearise, usual_size, with_values
from rlco.physics.effects import AppliedEffect, Parameter

ONE, OTHER = Candidate("one", "elbow"), Candidate("other", None)
LOW, HIGH = -2.0, 3.0


class Counted:
    """Weighted residuals of numbers, by a formula; counts how many it gave."""

    def __init__(self, formula: Callable[[Array], Array]) -> None:
        self.formula, self.count = formula, 0

    def __call__(self, lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
        self.count += len(lists)
        rows = [[v for effect in effects for v in effect.values] for effects in lists]
        return np.stack([self.formula(np.array(row)) for row in rows])


def numbers(count: int, resolution: float = 0.0) -> tuple[Parameter, ...]:
    """Return parameters between LOW and HIGH."""
    return tuple(
        Parameter(f"p{i}", "1", LOW, HIGH, 0.0, (0.5,), resolution=resolution)
        for i in range(count)
    )


def start(*values: float) -> tuple[AppliedEffect, ...]:
    """Return both effects: one with all numbers but the last, the other with it."""
    return with_values(library(len(values)), [ONE, OTHER], np.array(values))


def library(count: int) -> dict[Candidate, tuple[Parameter, ...]]:
    """Return both effects with `count` numbers together."""
    return {ONE: numbers(count - 1), OTHER: numbers(1)}


def values_of(effects: Sequence[AppliedEffect]) -> Array:
    """Return all numbers of effects, in order."""
    return np.array([v for effect in effects for v in effect.values])


MATRIX = np.random.default_rng(3).normal(size=(40, 3))


def bent(values: Array) -> Array:
    """Return a smooth residual that no straight line follows."""
    bend = np.sinh(0.7 * (MATRIX @ np.column_stack([values, [0.4, -0.3, 0.8]])))
    return np.asarray(bend[:, 0] - bend[:, 1])


def test_straight_residual_costs_one_step_and_a_look_back() -> None:
    """Start, differences, a step; what says that it was the last costs as much."""
    whiten = Counted(lambda values: MATRIX @ (values - [0.4, -0.3, 0.8]) + 1e-3)
    (found,) = fit(library(3), [start(0.0, 0.0, 0.0)], whiten, tolerance=1e-6)
    again = least_squares(whiten.formula, np.zeros(3)).x
    np.testing.assert_allclose(values_of(found.effects), again, atol=1e-3)
    # 1 start, 3 differences, then at most two steps of little gain, differences, and
    # a whole and a shorter step that gain nothing.
    assert whiten.count <= 1 + 3 + 1 + 2 + 3 + 2


def test_bent_residual_needs_fewer_simulations_than_differences_at_each_step() -> None:
    """Corrected differences reach the same numbers for less."""
    whiten, steps = Counted(bent), 12
    (found,) = fit(
        library(3), [start(0.0, 0.0, 0.0)], whiten, steps=steps, tolerance=1e-8
    )
    np.testing.assert_allclose(values_of(found.effects), [0.4, -0.3, 0.8], atol=1e-5)
    assert whiten.count < 0.6 * steps * (3 + 2)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-1.8, 2.8), min_size=3, max_size=3),
    st.lists(st.floats(-3.0, 4.0), min_size=3, max_size=3),
)
def test_fit_within_bounds_is_as_good_as_scipys(
    begin: list[float], goal: list[float]
) -> None:
    """The best numbers may lie outside the bounds; then both stop at them."""

    def formula(values: Array) -> Array:
        away = MATRIX @ (values - goal)
        return np.asarray(away + 0.1 * away**2 + 0.1)

    whiten = Counted(formula)
    (found,) = fit(library(3), [start(*begin)], whiten, steps=40, tolerance=1e-7)
    known = least_squares(formula, begin, bounds=(LOW, HIGH), xtol=1e-12, ftol=1e-12)
    values = values_of(found.effects)
    assert (values >= LOW).all()
    assert (values <= HIGH).all()
    assert found.cost <= 2.0 * known.cost / len(MATRIX) * (1.0 + 1e-2)
    np.testing.assert_allclose(found.residual, formula(values))
    assert found.cost == pytest.approx(float(np.mean(found.residual**2)))


def test_known_differences_save_simulations_and_change_no_answer() -> None:
    """A fit of the first effects lends its differences to those that add one."""
    one = {ONE: numbers(2)}
    fitted = fit(
        one,
        [with_values(one, [ONE], np.zeros(2))],
        lambda lists: np.stack([bent(np.append(values_of(e), 0.0)) for e in lists]),
    )[0]
    near = linearise(
        one,
        fitted.effects,
        lambda lists: np.stack([bent(np.append(values_of(e), 0.0)) for e in lists]),
    )
    begin = (*fitted.effects, *start(0.0, 0.0, 0.1)[1:])
    with_, without = Counted(bent), Counted(bent)
    lent = fit(library(3), [begin], with_, steps=2, near=near)[0]
    own = fit(library(3), [begin], without, steps=2)[0]
    assert with_.count == without.count - 2
    for found in (lent, own):
        np.testing.assert_allclose(
            values_of(found.effects), [0.4, -0.3, 0.8], atol=0.25
        )


def test_number_that_jumps_is_found_from_afar() -> None:
    """No slope shows the way from one jump to the next."""
    step = 0.1
    known = {ONE: numbers(1), OTHER: numbers(1, resolution=step)}

    def formula(values: Array) -> Array:
        jumped = np.floor(values[1] / step + 1e-9) * step
        return np.asarray(MATRIX[:, :2] @ [values[0] - 0.7, jumped - 1.3])

    begin = with_values(known, [ONE, OTHER], np.array([0.0, 0.2]))
    (found,) = fit(known, [begin], Counted(formula), steps=12)
    slope, jumps = values_of(found.effects)
    assert slope == pytest.approx(0.7, abs=1e-3)
    assert 1.3 - 1e-6 <= jumps < 1.4


def test_fit_stays_out_of_what_diverges() -> None:
    """A step into divergence is no step; the shorter one is."""

    def formula(values: Array) -> Array:
        if values[0] > 1.0:
            return np.full(40, np.inf)
        grown = np.exp(MATRIX[:, :2] @ np.column_stack([values, [0.9, 0.1]]))
        return np.asarray(grown[:, 0] - grown[:, 1])

    (found,) = fit(library(2), [start(-1.0, -1.0)], Counted(formula), steps=20)
    np.testing.assert_allclose(values_of(found.effects), [0.9, 0.1], atol=1e-3)


def test_start_that_diverges_is_left_where_it_is() -> None:
    """Nothing is known of the way out, and nothing is spent on it."""
    whiten = Counted(lambda values: np.full(40, np.inf))
    (found,) = fit(library(2), [start(0.5, 0.5)], whiten)
    assert found.cost == np.inf
    assert whiten.count == 1
    np.testing.assert_array_equal(values_of(found.effects), [0.5, 0.5])


def test_a_number_of_waves_is_differentiated_in_steps_that_they_stand() -> None:
    path = np.linspace(-2.0, 2.0, 400)
    count = Parameter("count", "1/turn", 1, 1e3, 20, (20.0,), scales=False, step=1e-2)
    effect = AppliedEffect("one", "elbow", {"count": 150.0})
    waves = Counted(lambda values: np.sin(values[0] * path))
    found = linearise({ONE: (count,)}, [effect], waves)
    # A share of the value, 1.5, would turn the ends of the path by half a wave.
    np.testing.assert_allclose(found.jacobian[0], path * np.cos(150 * path), atol=0.03)


@pytest.mark.parametrize("seed", range(3))
def test_jumps_where_contacts_are_made_do_not_end_a_fit_on_its_way(seed: int) -> None:
    problem = arm_problem(recordings=1, seconds=0.2)
    problem.has_outliers = True
    known = library_of(problem)
    (candidate, (friction,)), *_ = known.items()
    size, random = usual_size(friction), np.random.default_rng(seed)
    rates, phases = random.uniform(300.0, 900.0, 40), random.uniform(0.0, 6.0, 40)
    rates[8:] = 0.0  # rows that no contact moves

    def formula(values: Array) -> Array:
        part = values[0] / size
        jumps = np.sign(np.sin(rates * part + phases))
        return np.asarray(8.0 * MATRIX[:, 0] * (part - 0.8) + jumps)

    begin = with_values(known, [candidate], np.array([0.4 * size]))
    (found,) = fit(known, [begin], Counted(formula), steps=12, tolerance=1e-4)
    assert values_of(found.effects)[0] == pytest.approx(0.8 * size, rel=0.08)
