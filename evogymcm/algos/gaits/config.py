"""Settings of a search of gaits: plain data, without numba."""

from dataclasses import dataclass

from evogymcm._settings import check_fields

_BOUNDS: dict[str, dict[str, float]] = {
    "early": {"low": 0, "high": 1},
    "sigma": {"above": 0},
    "seed": {"low": 0},
    "candidates": {"low": 2},
}


@dataclass(frozen=True)
class GaitConfig:
    """Settings of a search of gaits. The defaults were found on random bodies in four tasks.

    Attributes:
        env_steps: Env-steps for each design at most, counted as if no episode ended before its time.
        first: Gaits of the first generation, drawn at random.
        candidates: Gaits of each later generation, of a CMA-ES that begins at the best one so far.
        trial_steps: Env-steps of the early trials; None for whole episodes from the start.
        early: Share of the env-steps that early trials may take. After them gaits are played for whole episodes, the
            best one so far among them.
        sigma: First step of CMA-ES, where 1 is the spread of random gaits.
        seed: Seed of the search, and of what tasks draw at resets.

    Raises:
        ValueError: A value is of the wrong kind or out of range.
    """

    env_steps: int = 50_000
    first: int = 32
    candidates: int = 8
    trial_steps: int | None = 150
    early: float = 0.5
    sigma: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self, _BOUNDS)
