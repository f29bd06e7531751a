"""Sampling and mutation of bodies.

The expected numbers were measured on EvoGym's own functions. The tolerances are about four standard errors of the means
at the sizes used here.
"""

import numpy as np
import pytest

from evogymcm.body import (
    EMPTY,
    SAMPLE_WEIGHTS,
    Body,
    has_actuator,
    is_connected,
    mutate_body,
    sample_body,
)


@pytest.fixture(scope="module")
def sampled():
    rng = np.random.default_rng(0)
    return [sample_body((5, 5), rng) for _ in range(3000)]


def test_samples_are_distributed_as_in_evogym(sampled):
    voxels = np.array([body.n_voxels for body in sampled])
    assert voxels.mean() == pytest.approx(16.7, abs=0.15)
    assert voxels.std() == pytest.approx(2.1, abs=0.12)
    assert np.mean([body.n_actuators for body in sampled]) == pytest.approx(8.4, abs=0.15)
    grids = np.stack([body.grid for body in sampled])
    shares = np.array([(grids == code).sum() for code in range(1, 5)]) / (grids != EMPTY).sum()
    np.testing.assert_allclose(shares, 0.25, atol=0.008)
    assert np.mean(~grids[:, -1].any(axis=1)) == pytest.approx(0.021, abs=0.011)


def test_share_of_valid_draws_is_evogyms():
    rng = np.random.default_rng(0)
    probabilities = np.array(SAMPLE_WEIGHTS) / sum(SAMPLE_WEIGHTS)
    grids = rng.choice(5, size=(10_000, 5, 5), p=probabilities)
    assert np.mean([is_connected(grid) and has_actuator(grid) for grid in grids]) == pytest.approx(0.146, abs=0.015)


def test_sampling_is_reproducible_and_takes_weights():
    first, second = (sample_body((3, 4), np.random.default_rng(7)) for _ in range(2))
    assert first == second
    assert first.shape == (3, 4)
    assert first.has_default_connections
    only_actuators = sample_body((3, 3), np.random.default_rng(0), weights=(0, 0, 0, 1, 1))
    assert only_actuators.n_actuators == 9


def test_impossible_samples_are_refused(monkeypatch):
    rng = np.random.default_rng(0)
    for weights in [
        (1, 1, 1, 0, 0),
        (1, 1, 1, 1),
        (1, 1, 1, 1, -1),
        (1, 1, 1, 1, np.nan),
        (0, 0, 0, 0, 0),
        {},
        1j,
        [10**400] * 5,
    ]:
        with pytest.raises(ValueError, match="weights"):
            sample_body((5, 5), rng, weights)
    with pytest.raises(ValueError, match="shape"):
        sample_body((0, 5), rng)
    monkeypatch.setattr("evogymcm.body._MAX_DRAWS", 100)
    with pytest.raises(ValueError, match="none of 100 draws"):
        sample_body((9, 9), rng, weights=(1e9, 1, 1, 1, 1))


def test_mutants_are_distributed_as_in_evogym(sampled):
    rng = np.random.default_rng(1)
    children = [mutate_body(parent, rng) for parent in sampled]
    assert np.mean([child is None for child in children]) == pytest.approx(0.04, abs=0.015)
    pairs = [(p, c) for p, c in zip(sampled, children, strict=True) if c is not None]
    assert len([1 for p, c in pairs if p == c]) / len(sampled) == pytest.approx(0.14, abs=0.026)
    assert np.mean([(p.grid != c.grid).sum() for p, c in pairs]) == pytest.approx(4.0, abs=0.35)


def test_a_single_attempt_changes_cells_at_the_rates_of_evogym(sampled):
    rng = np.random.default_rng(2)
    children = [mutate_body(parent, rng, attempts=1) for parent in sampled]
    assert np.mean([child is not None for child in children]) == pytest.approx(0.74, abs=0.033)
    # Nearly every mutant of a full block of many voxels is valid, so that the rates of single cells are seen.
    full = Body([[3, 4] * 10] * 20)
    mutants = [child for _ in range(200) if (child := mutate_body(full, rng, rate=0.05, attempts=1)) is not None]
    assert len(mutants) > 150
    grids = np.stack([child.grid for child in mutants])
    assert np.mean(grids != full.grid) == pytest.approx(0.05 * 6 / 7, abs=0.004)
    assert np.mean(grids == EMPTY) == pytest.approx(0.05 * 3 / 7, abs=0.003)


def slow_mutate(parent, rng, rate, attempts):
    """The rule spelled out cell by cell; returns the grid and the number of attempts, or None."""
    thresholds = np.cumsum(SAMPLE_WEIGHTS) / sum(SAMPLE_WEIGHTS)
    child = parent.grid.copy()
    for attempt in range(attempts):
        chances, draws = rng.random(parent.shape), rng.random(parent.shape)
        for cell in np.ndindex(parent.shape):
            if chances[cell] < rate:
                child[cell] = next(code for code in range(5) if draws[cell] <= thresholds[code])
        if is_connected(child) and has_actuator(child):
            return child, attempt + 1
    return None


def test_failed_attempts_accumulate(sampled):
    late = 0
    for seed, parent in enumerate(sampled[:150]):
        child = mutate_body(parent, np.random.default_rng(seed), rate=0.2, attempts=20)
        expected = slow_mutate(parent, np.random.default_rng(seed), rate=0.2, attempts=20)
        if expected is None:
            assert child is None
        else:
            np.testing.assert_array_equal(child.grid, expected[0])
            late += expected[1] > 1
    assert late > 20


def test_mutation_drops_partial_connections_and_checks_its_arguments():
    rng = np.random.default_rng(0)
    parent = Body("HR/RR", [[0], [1]])
    child = mutate_body(parent, rng, rate=0.0)
    assert child == Body("HR/RR")
    for arguments in ({"rate": 1.5}, {"rate": np.nan}, {"attempts": 0}):
        with pytest.raises(ValueError, match="expected"):
            mutate_body(parent, rng, **arguments)


def test_mutation_and_samples_take_arrays_and_seeds():
    expected = mutate_body(Body("HHV/RSR/H.H"), np.random.default_rng(3))
    assert mutate_body("HHV/RSR/H.H", 3) == mutate_body(Body("HHV/RSR/H.H").grid, np.int64(3)) == expected
    assert sample_body((4, 4), 0) == sample_body((4, 4), np.random.default_rng(0))
    for rng in (None, -1, 0.5, np.random):
        with pytest.raises(ValueError, match=r"rng: got .*Generator or a seed"):
            sample_body((5, 5), rng)
        with pytest.raises(ValueError, match="rng: got"):
            mutate_body("HH", rng)
