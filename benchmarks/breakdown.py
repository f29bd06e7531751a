"""Measures where a substep's time goes: each kernel alone, many times over, on worlds in motion.

    python benchmarks/breakdown.py Walker-v0

Eight worlds of the standard body, after 40 env-steps of random actions. Kernels are called from compiled loops, so that
no call from Python is counted. The parts need not add up to the whole: each runs with a warm cache of its own.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from evogymcm.envs.core import TaskEngine
from evogymcm.sim import candidates, contact, springs
from evogymcm.sim.advance import advance
from evogymcm.sim.constants import MISSING, SUBSTEPS
from evogymcm.sim.springs import STAGE_X, STAGE_Y, Pulls

STANDARD_BODY = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"
ALL = 255  # the mask of eight lanes
_N = 200

_loop: Any = numba.njit(error_model="numpy", _nrt=False)


def repeated(kernel: Any) -> Callable[..., None]:
    """Returns a compiled loop that calls a kernel `_N` times."""

    @_loop
    def run(arguments: Any) -> None:
        for _ in range(_N):
            kernel(*arguments)

    return run


def microseconds(run: Callable[[], Any], calls: int = _N) -> float:
    """Returns the least time of a call, of several tries."""
    run()
    best = np.inf
    for _ in range(15):
        start = time.perf_counter()
        run()
        best = min(best, (time.perf_counter() - start) / calls)
    return best * 1e6


def main() -> None:
    """Prints a row a part: microseconds a call, calls a substep, microseconds a substep of eight worlds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", nargs="?", default="Walker-v0")
    engine = TaskEngine(parser.parse_args().task, STANDARD_BODY, 8, num_threads=1)
    rng = np.random.default_rng(0)
    actions = rng.uniform(0.6, 1.6, (40, *engine.occupancy.shape))
    for action in actions:
        engine.step(action)
    simulator = engine.simulator
    layout, state, physics = simulator.blocks[0].layout, simulator.blocks[0].state, simulator.physics.values()
    points, forces = state.points, state.springs
    pulls = Pulls(layout.pulls_start, layout.pulls_turn, layout.pulls)
    lists = (layout, points, state.boxes, ALL, state.nearby, state.pairs, state.counts, state.crowded)
    touch = (layout.corners, layout.sides, layout.is_surface, layout.cell_object, layout.static_points)
    parts: list[tuple[str, Any, tuple[Any, ...], float]] = [
        ("spring forces", springs._pull, (layout.ends, points, forces, STAGE_X, STAGE_Y, 0.0), 4),
        ("stages of the integration", springs._middle_stage, (pulls, forces, points, 0.5, physics), 4),
        (
            "limits on lengths",
            springs.limit_lengths,
            (layout.ends, layout.rest, layout.is_free, points, forces, state.beyond),
            1,
        ),
        ("limits of rigid voxels", springs.limit_rigid, (layout.rigid, layout.ends, layout.rest, points), 1),
        ("contact, exact rule", contact.respond, (*touch, points, ALL, state.pairs, state.counts, physics), 1),
        ("lists of candidates", candidates.list_candidates, lists, listings(engine, actions) / SUBSTEPS),
    ]
    print(f"{len(layout.initial)} points, {len(layout.rest)} springs, {len(layout.grid_cells)} moving surface voxels")
    print(f"{'':28}{'us a call':>12}{'calls':>8}{'us a substep':>14}")
    total = 0.0
    for name, kernel, arguments, calls in parts:
        saved = simulator.state()
        run, fixed = repeated(kernel), arguments
        cost = microseconds(lambda run=run, fixed=fixed: run(fixed))  # type: ignore[misc]
        simulator.set_state(saved)
        total += cost * calls
        print(f"{name:28}{cost:12.2f}{calls:8.2f}{cost * calls:14.2f}")
    whole = microseconds(lambda: [simulator.step(a) for a in actions], len(actions)) / SUBSTEPS
    print(f"{'sum':48}{total:14.2f}\n{'a whole env-step / 30':48}{whole:14.2f}")


def listings(engine: TaskEngine, actions: np.ndarray) -> float:
    """Returns how often an env-step makes the lists, by the way that points go in it."""
    block, count = engine.simulator.blocks[0], 0
    nothing = np.empty((0, engine.simulator.n_cells))
    physics = engine.simulator.physics.values()
    for action in actions[:10]:
        listed = None
        for _ in range(SUBSTEPS):
            advance(block.layout, physics, block.state, block.worlds, action, nothing, 1)
            now = block.state.points[springs.X : springs.Y + 1][..., block.worlds != MISSING].copy()
            if listed is None or np.abs(now - listed).max() > candidates.SKIN / 2:
                listed, count = now, count + 1
    return count / 10


if __name__ == "__main__":
    main()
