"""Simulator: many worlds, advanced together."""

import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from evogymcm.sim._threads import Threads
from evogymcm.sim.constants import SUBSTEPS, Physics
from evogymcm.sim.designs import Objects
from evogymcm.sim.kernels._jit import announce_compilation, entry
from evogymcm.sim.kernels.advance import Room, Scratch, advance, new_scratch, set_stiffness
from evogymcm.sim.kernels.work import N_SCRATCH, N_WORK, Commands, command_work
from evogymcm.sim.scene import Scene
from evogymcm.sim.worlds import Worlds


class Simulator(Worlds):
    """Many voxel worlds that advance together; arrays in, arrays out, indexed by world.

    Each world is simulated by itself: to the last bit its result depends neither on the others nor on the number of
    threads, and worlds with different robots cost no more than equal ones.

    Args:
        worlds: For each world its placed objects, the robot first.
        edge_rule: How stiffness acts on shared edges, see `Scenery`.
        physics: The constants; the benchmark's by default.
        num_threads: Threads for the worlds; all cores by default.
        grid_shape: (rows, columns) of the grid in which actuation and stiffness are given, V = rows * columns; robots
            stand in its upper left corner. By default the smallest that holds every robot.
        placed: Objects that `reset` may place anew.

    Raises:
        ValueError: For no worlds, a grid too small, a number of threads below 1, or an unknown edge rule.
    """

    def __init__(
        self,
        worlds: Sequence[Objects],
        edge_rule: str = "mean_factor",
        physics: Physics | None = None,
        num_threads: int | None = None,
        grid_shape: tuple[int, int] | None = None,
        placed: Sequence[str] = (),
    ) -> None:
        if num_threads is not None and num_threads < 1:
            raise ValueError(f"num_threads: got {num_threads}, at least 1 is needed")
        announce_compilation(advance)
        super().__init__(worlds, edge_rule, physics, grid_shape, placed)
        available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
        self.num_threads = num_threads or available
        self._threads = Threads(self.num_threads)
        self._all = np.arange(self.n_worlds)
        self._unchanged = np.empty((0, self.n_cells))  # what stands for no stiffness
        self._scratches: list[Scratch] = []  # one a thread
        self._advance: Any = None  # the kernel, once there are scratches
        self._work: Any = None  # the kernel, once it is used

    def _lay_out(self, scenes: Iterable[Scene]) -> None:
        room = self._room
        super()._lay_out(scenes)
        if room != self._room:
            self._scratches = []

    def reset(self, mask: np.ndarray | None = None, offsets: np.ndarray | None = None) -> None:
        """Puts worlds back to their initial positions, at rest.

        Args:
            mask: (N,) bool, the worlds to reset; all by default.
            offsets: (N, 2) voxels, whole numbers, by which the objects named in `placed` are moved from their places.

        Raises:
            ValueError: For another shape.
        """
        if offsets is not None:
            offsets = self._rows("offsets", offsets, 2)
        for world in self._chosen(mask):
            if offsets is not None:
                self._set_objects(int(world), self._moved(int(world), offsets[world]))
                self._offsets[world] = offsets[world]
            self._put_back(world)

    def set_stiffness(self, stiffness: np.ndarray, mask: np.ndarray | None = None) -> None:
        """Sets the stiffness field of worlds, until it is set again.

        Args:
            stiffness: (N, V) factors, float64; cells without a voxel have no effect.
            mask: (N,) bool, the worlds to set; all by default.

        Raises:
            ValueError: For another shape.
        """
        stiffness = self._rows("stiffness", stiffness, self.n_cells)
        set_stiffness(self._storage, self._chosen(mask), stiffness)

    def step(
        self,
        actuation: np.ndarray,
        stiffness: np.ndarray | None = None,
        mask: np.ndarray | None = None,
        then: Callable[[np.ndarray, int], None] | None = None,
    ) -> np.ndarray:
        """Advances worlds by one env-step (30 substeps).

        Args:
            actuation: (N, V) target lengths relative to rest, float64; used as they are, at cells with an actuator.
            stiffness: (N, V) stiffness factors, float64, or None to keep the current ones.
            mask: (N,) bool, the worlds to advance; all by default.
            then: Called in each thread, with the (m,) worlds that it has advanced and the number of the thread.

        Returns:
            (N,) bool, the worlds that became unstable: these are in the state from before the step.

        Raises:
            ValueError: For another shape.
        """
        return self.substeps(SUBSTEPS, actuation, stiffness, mask, then)

    def substeps(
        self,
        n: int,
        actuation: np.ndarray,
        stiffness: np.ndarray | None = None,
        mask: np.ndarray | None = None,
        then: Callable[[np.ndarray, int], None] | None = None,
    ) -> np.ndarray:
        """Advances worlds by `n` substeps, see `step`."""
        unstable = np.zeros(self.n_worlds, bool)
        actuation = self._rows("actuation", actuation, self.n_cells)
        factors = self._unchanged if stiffness is None else self._rows("stiffness", stiffness, self.n_cells)
        chosen = self._all if mask is None else self._chosen(mask)
        if not self._scratches:
            self._get_ready()

        def run(worlds: np.ndarray, thread: int) -> None:
            done = self._advance(self._storage, self._scratches[thread], worlds, actuation, factors, n, unstable)
            while done < len(worlds):
                self._enlarge(thread)
                scratch = self._scratches[thread]
                done += self._advance(self._storage, scratch, worlds[done:], actuation, factors, n, unstable)
            if then is not None:
                then(worlds, thread)

        if self.num_threads == 1 or len(chosen) < 2:
            if len(chosen):
                run(chosen, 0)
        else:
            self._threads.run(run, chosen, self._costs[chosen])
        return unstable

    def command_work(
        self,
        before: tuple[np.ndarray, np.ndarray],
        after: tuple[np.ndarray, np.ndarray],
        mask: np.ndarray | None = None,
    ) -> np.ndarray:
        """Returns the work that a change of actuation and stiffness would do on robots as they are now.

        It is what the change adds to the energy of a robot's springs, in units of the simulator: a point has mass 1,
        lengths are metres. See the documentation's page on work.

        Args:
            before: (N, V) actuation and (N, V) stiffness until now, float64.
            after: Those from now on.
            mask: (N,) bool, the worlds meant; all by default. The others' work is 0.

        Returns:
            (N, 4): what actuation and what stiffness supply, summed over those springs whose energy they raise; then
            the same two summed over all springs, so that what comes back is subtracted.

        Raises:
            ValueError: For another shape.
        """
        names = ("actuation", "stiffness")
        old, new = (
            Commands(*(self._rows(name, part, self.n_cells) for name, part in zip(names, parts, strict=True)))
            for parts in (before, after)
        )
        work, scratch = np.zeros((self.n_worlds, N_WORK)), np.empty(N_SCRATCH * self._room.springs)
        arguments = self._storage, self._chosen(mask), old, new, scratch, work
        if self._work is None:
            self._work = entry(command_work, *arguments)
        self._work(*arguments)
        return work

    def _get_ready(self) -> None:
        """Makes what threads need to advance worlds."""
        self._scratches = [new_scratch(self._room) for _ in range(min(self.num_threads, self.n_worlds))]
        none = np.zeros(0, bool)
        self._advance = entry(
            advance, self._storage, self._scratches[0], self._all, self._unchanged, self._unchanged, SUBSTEPS, none
        )

    def _enlarge(self, thread: int) -> None:
        """Makes more room for a thread's lists."""
        room = Room(*self._scratches[thread].ints[: len(Room._fields)].tolist())
        more = room._replace(candidates=2 * room.candidates, contacts=2 * room.contacts)
        self._scratches[thread] = new_scratch(more)

    def _rows(self, name: str, values: np.ndarray, n_columns: int) -> np.ndarray:
        """Returns (N, n_columns) float64 as kernels take it: they check neither shape nor indices."""
        values = np.ascontiguousarray(values, np.float64)
        if values.shape != (self.n_worlds, n_columns):
            raise ValueError(f"{name}: got shape {values.shape}, expected {(self.n_worlds, n_columns)}")
        return values

    def _chosen(self, mask: np.ndarray | None) -> np.ndarray:
        """Returns the numbers of the chosen worlds."""
        if mask is None:
            return self._all
        if mask.shape != (self.n_worlds,) or mask.dtype != bool:
            raise ValueError(f"mask: got {mask.dtype} of shape {mask.shape}, expected bool of shape ({self.n_worlds},)")
        return np.flatnonzero(mask)

    def close(self) -> None:
        """Ends the threads. A later step starts them again."""
        self._threads.close()

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"_scratches": [], "_advance": None, "_work": None}
