"""Seeds of the parts of a run, each with draws of its own."""

import numpy as np

__all__ = ["derived_seed"]


def derived_seed(seed: int, *place: int) -> int:
    """Returns the seed of a place in a run, such as (generation, stage), which no other place or run shares.

    numpy's `SeedSequence` mixes the run's seed with the place. Of sums such as seed + generation, in contrast, one run
    has the same as another.
    """
    return int(np.random.SeedSequence(seed, spawn_key=place).generate_state(1, np.uint64)[0] >> 1)  # fits an int64
