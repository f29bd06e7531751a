"""A task whose episodes end at random times, for tests of environments in which every body ends alone."""

from dataclasses import dataclass

import numpy as np

from evogymcm.envs.tasks.walking import Walking


@dataclass(frozen=True)
class Lottery(Walking):
    """Walking on flat ground, for as many steps as each episode draws at its start."""

    def draw(self, rng):
        return {"left": np.array(rng.integers(2, 9))}

    def remember(self, after):
        return {"left": after.memory["left"] - 1}

    def endings(self, after):
        yield after.memory["left"] <= 1, 0.0


LOTTERY = Lottery("Lottery", "Walker-v0", (1, 1), 500, observes=("velocity", "relative"))
