"""Linear factors of known blocks, on more variables than the wheel's own constructor takes."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from factors.known import block_factor, jacobian_factor

RNG_SEED = 11


def drawn(rng: np.random.Generator, sizes: list[int], rows: int) -> tuple[list[int], list[np.ndarray], np.ndarray]:
    """Keys out of order, blocks and an error."""
    keys = rng.permutation(np.arange(10, 10 + len(sizes))).tolist()
    return keys, [rng.normal(size=(rows, size)) for size in sizes], rng.normal(size=rows)


@pytest.mark.parametrize("rows", [1, 2, 20])
def test_is_the_wheels_own_factor(rows: int) -> None:
    """The same matrices and error as a Jacobian factor of three variables, given either way."""
    rng = np.random.default_rng(RNG_SEED)
    keys, blocks, error = drawn(rng, [6, 8, 4], rows)
    unit = gtsam.noiseModel.Unit.Create(rows)
    own = gtsam.JacobianFactor(keys[0], blocks[0], keys[1], blocks[1], keys[2], blocks[2], -error, unit)
    side_by_side = np.asfortranarray(np.column_stack([*blocks, -error]))
    at = gtsam.VectorValues()
    for key, size in zip(keys, [6, 8, 4], strict=True):
        at.insert(key, rng.normal(size=size))
    for made in (jacobian_factor(keys, blocks, error), block_factor(keys, [6, 8, 4], side_by_side)):
        linear, expected = gtsam.GaussianFactorGraph(), gtsam.GaussianFactorGraph()
        linear.push_back(made)
        expected.push_back(own)
        assert list(linear.at(0).keys()) == keys
        np.testing.assert_array_equal(linear.at(0).augmentedJacobian(), own.augmentedJacobian())
        np.testing.assert_allclose(linear.hessian()[0], expected.hessian()[0], atol=1e-12)
        assert linear.error(at) == pytest.approx(expected.error(at), rel=1e-12)


@pytest.mark.parametrize("eliminate", ["eliminateMultifrontal", "eliminateSequential"])
@pytest.mark.parametrize("rows", [3, 40])
def test_many_variables_are_eliminated_as_dense_least_squares(eliminate: str, rows: int) -> None:
    """Seven variables in one factor, with fewer and more rows than columns, beside priors on each."""
    rng = np.random.default_rng(RNG_SEED)
    sizes = [6, 8, 4, 4, 3, 4, 1]
    keys, blocks, error = drawn(rng, sizes, rows)
    linear = gtsam.GaussianFactorGraph()
    linear.push_back(jacobian_factor(keys, blocks, error))
    for key, size in zip(keys, sizes, strict=True):
        linear.add(key, np.eye(size), np.ones(size), gtsam.noiseModel.Unit.Create(size))
    dense = np.vstack([np.column_stack(blocks), np.eye(sum(sizes))])
    expected = np.linalg.lstsq(dense, np.r_[-error, np.ones(sum(sizes))], rcond=None)[0]
    solved = getattr(linear, eliminate)(gtsam.Ordering.ColamdGaussianFactorGraph(linear)).optimize()
    found = np.concatenate([solved.at(key) for key in keys])
    np.testing.assert_allclose(found, expected, atol=1e-10)
