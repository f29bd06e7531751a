"""Measures where a substep's time goes: each kernel alone, many times over, on worlds in motion.

    python benchmarks/breakdown.py Walker-v0

Eight worlds of the standard body, after 40 env-steps of random actions; the numbers are means over them, of one world.
Kernels are called from compiled loops, so that no call from Python is counted. The parts need not add up to the whole:
each runs with a warm cache of its own.
"""

import argparse
import time
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np

from evogymcm.envs import TaskEngine
from evogymcm.sim.constants import SUBSTEPS
from evogymcm.sim.kernels import candidates, contact, springs
from evogymcm.sim.kernels.vectors import aligned_zeros, on_lines
from evogymcm.sim.scene import Layout, Terrain
from evogymcm.sim.simulator import Simulator
from evogymcm.sim.tables import _numpy_unpacker

STANDARD_BODY = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"
_N, _WORLDS, _ROOM = 200, 8, 5000  # calls at a time; worlds; candidates and contacts

_loop: Any = numba.njit(error_model="numpy", _nrt=False)


@cache
def called(kernel: Any) -> Callable[..., Any]:
    """Returns what calls a kernel that only kernels can call."""

    @_loop
    def run(arguments: Any) -> Any:
        return kernel(*arguments)

    return run


@cache
def repeated(kernel: Any) -> Callable[..., None]:
    """Returns a compiled loop that calls a kernel `_N` times."""

    @_loop
    def run(arguments: Any) -> None:
        for _ in range(_N):
            kernel(*arguments)

    return run


def microseconds(run: Callable[[], Any], calls: int = _N) -> float:
    """Returns the least processor time of a call, of several tries."""
    run()
    best = np.inf
    for _ in range(15):
        start = time.process_time()
        run()
        best = min(best, (time.process_time() - start) / calls)
    return best * 1e6


def parts(simulator: Simulator, world: int, listings: float) -> list[tuple[str, Any, tuple[Any, ...], float]]:
    """Returns each part's name, its kernel, what that takes in a world, and how often a substep calls it."""
    storage, (design, scenery) = simulator.storage, simulator.storage.design_of[world]
    layout = _numpy_unpacker(Layout)(storage.ints[design], storage.floats[design])
    terrain = _numpy_unpacker(Terrain)(storage.terrain_ints[scenery], storage.terrain_floats[scenery])
    m, s, cells = len(layout.initial), len(layout.rest), len(layout.surface)
    state = springs.SpringState(*np.split(storage.state[world, : 3 * (m + s)], np.cumsum([m, m, m, s, s])))
    tables = springs.SpringTables(*(getattr(layout, name) for name in springs.SpringTables._fields))
    floats = map(aligned_zeros, (*[m] * 7, s, springs.FIRST_FORCE + 2 * s))
    scratch, xy, physics = springs.SpringScratch(*floats, np.zeros(s, np.int32)), state.xy, simulator.physics.values()
    integers = [np.zeros(shape, np.int32) for shape in ((_ROOM, 3), _ROOM, 99, (_ROOM, contact.N_WHICH), m)]
    nodes, keys = aligned_zeros(4, len(layout.leaf) * 2), np.zeros((_ROOM, 3), np.uint64)
    sorting = contact.Sorting(nodes, keys, *integers[:3])
    contacts = contact.Contacts(integers[3], np.zeros((_ROOM, contact.N_HOW)), integers[4], sorting)
    pairs = np.zeros((_ROOM, candidates.N_FOUND), np.int32), np.zeros((cells * cells, 2), np.int32)
    lists = (layout, terrain, xy, aligned_zeros(4, on_lines(cells) + 8), *pairs)
    n_found, _ = called(candidates.list_candidates)(lists)
    n = called(contact.find_contacts)((layout, terrain, xy, pairs[0], n_found, contacts))
    stage = (tables, state, scratch, scratch.second_v, scratch.third_v, 0.5, physics)
    push = (layout, terrain, xy, state.old, contacts, n, scratch.contact, physics)
    return [
        ("spring forces", springs._pull, (layout.ends, xy, state, scratch.rest, scratch.force, 0.0), 4),
        ("stages of the integration", springs._middle_stage, stage, 4),
        ("limits on lengths", springs.limit_lengths, (tables, state, scratch), 1),
        ("limits of rigid voxels", springs.limit_rigid, (layout.rigid, xy), 1),
        ("lists of candidates", candidates.list_candidates, lists, listings),
        ("contacts", contact.find_contacts, (layout, terrain, xy, pairs[0], n_found, contacts), 1),
        ("their forces", contact.apply_contacts, push, float(n > 0)),
    ]


def listings_of(simulator: Simulator, actions: np.ndarray) -> float:
    """Returns how often a substep makes the lists, by the way that points go in it."""
    count, worlds = 0, range(_WORLDS)
    for action in actions:
        listed = [np.full((2, 1), np.inf)] * _WORLDS
        for _ in range(SUBSTEPS):
            for w, now in enumerate(map(simulator.points, worlds)):
                if not np.abs(now - listed[w]).max() <= candidates.SKIN / 2:
                    listed[w], count = now, count + 1
            simulator.substeps(1, action)
    return count / len(actions) / SUBSTEPS / _WORLDS


def main() -> None:
    """Prints a row a part: microseconds a call, calls a substep, microseconds a substep of one world."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", nargs="?", default="Walker-v0")
    simulator = TaskEngine(parser.parse_args().task, STANDARD_BODY, _WORLDS, num_threads=1).simulator
    actions = np.random.default_rng(0).uniform(0.6, 1.6, (40, _WORLDS, simulator.n_cells))
    for action in actions:
        simulator.step(action)
    listings, costs = listings_of(simulator, actions[:10]), np.zeros((_WORLDS, 7, 2))
    for world in range(_WORLDS):
        measured = parts(simulator, world, listings)
        for k, (_, kernel, arguments, calls) in enumerate(measured):
            saved, run = simulator.state(), repeated(kernel)
            costs[world, k] = microseconds(lambda run=run, fixed=arguments: run(fixed)), calls  # type: ignore[misc]
            simulator.set_state(saved)
    print(f"{simulator.points().shape[1]} points, {8e-3 * simulator.storage.state.shape[1]:.1f} kB of state a world")
    print(f"{'':28}{'us a call':>12}{'calls':>8}{'us a substep':>14}")
    a_substep = costs.prod(2).mean(0)
    for (name, *_), (cost, calls), substep in zip(measured, costs.mean(0), a_substep, strict=True):
        print(f"{name:28}{cost:12.3f}{calls:8.2f}{substep:14.3f}")
    steps = [lambda: simulator.set_state(saved), *(lambda a=a: simulator.step(a) for a in actions[:10])]  # type: ignore[misc]
    whole = microseconds(lambda: [step() for step in steps], 10 * _WORLDS) / SUBSTEPS
    print(f"{'sum':48}{a_substep.sum():14.3f}\n{'a whole env-step / 30':48}{whole:14.3f}")


if __name__ == "__main__":
    main()
