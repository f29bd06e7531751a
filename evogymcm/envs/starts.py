"""Starts that differ by 1e-6 metres, to see how much of an episode is chance: contact amplifies small differences."""

from collections.abc import Iterable, Sequence

import numpy as np

from evogymcm._settings import check_count
from evogymcm.sim.simulator import Simulator

START_NOISE = 1e-6  # metres


class Starts:
    """The starts of the episodes of some worlds.

    Start 0 is the exact one. In the others each point of the robot is moved by normal noise, drawn anew from the seed
    and the start's number: one start is the same in all worlds, for all their episodes.

    Args:
        part: Worlds that each start has: world w has start w // part.
        rngs: What the worlds beyond the first part drew from before, to be given back.
        seed: Where the noise comes from.
    """

    def __init__(self, part: int, rngs: Sequence[np.random.Generator], seed: int) -> None:
        self.part, self.rngs, self._seed = part, rngs, seed

    def move(self, simulator: Simulator, worlds: Iterable[int]) -> None:
        """Moves the robots of worlds that have just been reset."""
        for world in worlds:
            if start := int(world) // self.part:
                rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(start,)))
                robot = simulator.objects(world)[0]
                simulator.move(robot.name, START_NOISE * rng.standard_normal((len(robot.places), 2)), world)


def checked_part_of(starts: int, num_worlds: int, num_designs: int, *, is_stream: bool) -> int:
    """Returns how many worlds each start has.

    Raises:
        ValueError: The worlds are not the same ones as many times over.
    """
    part, rest = divmod(num_worlds, check_count("starts", starts))
    if starts > 1 and is_stream:
        raise ValueError(f"starts: got {starts}, under a stream of bodies no two worlds are the same (1)")
    if starts > 1 and (rest or part % num_designs):
        raise ValueError(
            f"starts: got {starts}, which does not share {num_worlds} worlds into equal parts, "
            f"each with all of {num_designs} designs equally often"
        )
    return part
