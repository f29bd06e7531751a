"""What to try next for one body's stiffness field: noise on the best so far (EvoGymCM), or CMA-ES (Hansen, 2016)."""

from math import log
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from evogymcm._extras import load_cma
from evogymcm._settings import check_choice
from evogymcm.algos.codesign.config import Noise, SearchConfig
from evogymcm.algos.codesign.design import Design
from evogymcm.body import STIFFNESS_HIGH, STIFFNESS_LOW

Field = NDArray[np.float64]


def perturb_stiffness(
    design: Design,
    rng: np.random.Generator,
    probability: float = 0.15,
    sigma: float = 0.2,
    noise: Noise = "multiplicative",
) -> Field:
    """Returns a design's stiffness field with noise on some of its voxels: (rows, cols) in [0.5, 2], 1 on empty cells.

    Args:
        design: body and stiffness to start from.
        rng: source of randomness.
        probability: how likely a voxel is to be changed, independently; if none is, one of them is, uniformly.
        sigma: standard deviation of the normal noise.
        noise: "multiplicative" (factors exp(noise), EvoGymCM's reference code) or "additive" (the EvoGymCM paper).
            Either result is clipped.

    Raises:
        ValueError: There is no such noise.
    """
    check_choice("noise", noise, get_args(Noise))
    voxels = design.field[design.body.occupancy]
    is_picked = rng.random(len(voxels)) < probability
    if not is_picked.any():
        is_picked[rng.integers(len(voxels))] = True
    errors = rng.normal(0.0, sigma, len(voxels))
    moved = voxels * np.exp(errors) if noise == "multiplicative" else voxels + errors
    return _on_body(design, np.where(is_picked, moved, voxels))


def _on_body(design: Design, voxels: Field) -> Field:
    """Returns the field (rows, cols) with these values, clipped, on the body's voxels, row-major."""
    field = np.ones(design.body.shape)
    field[design.body.occupancy] = np.clip(voxels, STIFFNESS_LOW, STIFFNESS_HIGH)
    return field


class HillClimber:
    """Perturbs the best field so far."""

    def __init__(self, rng: np.random.Generator, config: SearchConfig) -> None:
        self.rng, self.config = rng, config

    def ask(self, best: Design) -> list[Field]:
        """Returns noisy copies of the best field."""
        arguments = (best, self.rng, self.config.probability, self.config.sigma, self.config.noise)
        return [perturb_stiffness(*arguments) for _ in range(self.config.candidates)]

    def tell(self, scores: Field) -> None:
        """Learns nothing: the best field says it all."""


class CMA:
    """CMA-ES over the logarithms of the voxels' stiffness, begun at the given field."""

    def __init__(self, start: Design, rng: np.random.Generator, config: SearchConfig) -> None:
        options = {
            "bounds": [log(STIFFNESS_LOW), log(STIFFNESS_HIGH)],
            "popsize": config.candidates,
            "verbose": -9,
            "seed": np.nan,  # none; `randn` takes the place of numpy's global generator
            "randn": lambda *shape: rng.standard_normal(shape),
        }
        self.start = start
        voxels = start.field[start.body.occupancy]
        if len(voxels) == 1:
            options["maxstd_boundrange"] = 1e9  # pycma fails at a limit on the step of a single number
        self.optimizer = load_cma().CMAEvolutionStrategy(np.log(voxels), config.sigma, options)
        self.points: list[Field] = []

    def ask(self, best: Design) -> list[Field]:
        """Returns samples of the present distribution, whatever is best."""
        self.points = self.optimizer.ask()
        return [_on_body(self.start, np.exp(point)) for point in self.points]

    def tell(self, scores: Field) -> None:
        """Moves and shapes the distribution by the samples' ranks."""
        self.optimizer.tell(self.points, (-scores).tolist())  # it minimises
