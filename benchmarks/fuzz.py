"""Throws random bodies, materials and hard actions at the simulator, and checks that nothing breaks unseen.

    python benchmarks/fuzz.py --steps 5000000
    scripts/bounds.sh                           # every world, with all indices checked

Bodies are 1x1 to 10x10: random, with neighbours that are not joined, all rigid but one actuator, checkerboards. Actions
are uniform, or jump between the ends of their range in every step; stiffness is random in every step, or 2. Checked in
every step: all readings are finite; an unstable world ends with its state from before the step. Checked for one world
of every batch: alone, it does the same, bit for bit, whatever became of its neighbours.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from tqdm import tqdm

from evogymcm.body import Body, full_connections, sample_body
from evogymcm.envs import Task, TaskEngine, Window
from evogymcm.envs.tasks import tasks
from evogymcm.envs.tasks.walking import Walking
from evogymcm.sim.world import ROBOT, World, WorldObject

TASKS = (
    "Walker-v0",
    "BridgeWalker-v0",
    "CaveCrawler-v0",
    "AreaMaximizer-v0",
    "Pusher-v0",
    "Traverser-v0",
    "Climber-v0",
)
N_BODIES, N_COPIES, EPISODE = 16, 4, 60
LARGEST = 10  # rows and columns of bodies, where the task's spawn place has room


@dataclass
class Summary:
    """What a run has seen."""

    env_steps: int = 0
    bodies: int = 0
    unstable: int = 0
    compared: int = 0
    seconds: float = 0.0


def random_body(rng: np.random.Generator, largest: int) -> Body:
    """Returns a body of a random size and kind."""
    rows, columns = (int(n) for n in rng.integers(1, largest + 1, 2))
    kind = rng.choice(["random", "unjoined", "rigid", "checkerboard"])
    if kind == "checkerboard":
        grid = np.where(np.indices((rows, columns)).sum(0) % 2 == 0, rng.choice([3, 4]), rng.choice([1, 2]))
        return Body(grid)
    if kind == "rigid":
        grid = np.ones((rows, columns), int)
        grid[rng.integers(rows), rng.integers(columns)] = rng.choice([3, 4])
        return Body(grid)
    body = sample_body((rows, columns), rng)
    if kind == "unjoined":
        pairs = full_connections(body.grid)
        return Body(body.grid, pairs[:, rng.random(pairs.shape[1]) < 0.6])
    return body


def room(task: Task) -> int:
    """Returns the rows and columns of the largest square body that the task's spawn place admits."""
    world = task.world if isinstance(task.world, World) else World.load(task.world)
    for size in range(LARGEST, 1, -1):
        try:
            world.place(WorldObject(ROBOT, np.ones((size, size), int), task.spawn))
        except ValueError:
            continue
        return size
    return 1


def watching_all(task: Task) -> Task:
    """Returns a task in the same world that reads all there is: every object, and windows over all of them."""
    world = task.world if isinstance(task.world, World) else World.load(task.world)
    names = tuple(obj.name for obj in world.objects)
    observes = ("velocity", "orientation", "relative", "floor", "ceiling", *(f"offset:{name}" for name in names))
    window = Window(names, 7)
    options = {"floor": window, "ceiling": window, "reads_hull": True, "watches": names}
    return Walking(f"Watching {task.id}", world, task.spawn, task.time_limit, observes, **options)


def random_actions(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Returns actuation: uniform, or at the ends of the range."""
    if rng.random() < 0.5:
        return rng.uniform(0.6, 1.6, shape)
    return np.where(rng.random(shape) < 0.5, 0.6, 1.6)


def check_step(engine: TaskEngine, before: list[np.ndarray]) -> None:
    """Raises AssertionError where a number is not finite, or an unstable world is not as it was."""
    now = engine.snapshot
    values = [*now.robot, engine.reward, engine.features, engine.voxels]
    values += [reading for readings in now.objects.values() for reading in readings]
    assert all(np.isfinite(value).all() for value in values), "a reading is not finite"
    assert engine.terminated[engine.unstable].all(), "an unstable world goes on"
    for world in np.flatnonzero(engine.unstable):
        assert np.array_equal(engine.simulator.positions(world=int(world)), before[world]), "an unstable world moved"


def run_batch(task: Task, rng: np.random.Generator, summary: Summary, episode: int = EPISODE) -> None:
    """Steps one batch of bodies for an episode, and one of its worlds alone."""
    largest = room(task)
    bodies = [random_body(rng, largest) for _ in range(N_BODIES)]
    engine = TaskEngine(task, bodies, N_BODIES * N_COPIES, material="reactive", num_threads=1, seed=0)
    shape = engine.occupancy.shape
    is_stiff = rng.random() < 0.3
    watched = int(rng.integers(engine.num_worlds))
    alone = TaskEngine(task, engine.bodies[watched], 1, material="reactive", num_threads=1, seed=watched)
    rows, columns = engine.bodies[watched].shape
    cells = (np.arange(rows)[:, None] * engine.grid_shape[1] + np.arange(columns)).ravel()
    for _ in range(episode):
        actuation = random_actions(rng, shape)
        stiffness = np.full(shape, 2.0) if is_stiff else rng.uniform(0.5, 2.0, shape)
        before = [engine.simulator.positions(world=world) for world in range(engine.num_worlds)]
        engine.step(actuation, stiffness)
        check_step(engine, before)
        alone.step(actuation[watched : watched + 1, cells], stiffness[watched : watched + 1, cells])
        same = np.array_equal(engine.simulator.positions(world=watched), alone.simulator.positions())
        assert same, "a world depends on its neighbours"
        summary.unstable += int(engine.unstable.sum())
        for e in (engine, alone):
            ended = e.terminated | e.truncated
            if ended.any():
                e.reset(ended)
    summary.bodies += len(bodies)
    summary.env_steps += episode * engine.num_worlds
    summary.compared += episode


def fuzz(steps: int, seed: int = 0, progress: Callable[[int], object] = lambda _: None) -> Summary:
    """Runs batches until `steps` env-steps are done, and returns what was seen. Raises AssertionError for a fault."""
    rng, summary, start = np.random.default_rng(seed), Summary(), time.perf_counter()
    while summary.env_steps < steps:
        done = summary.env_steps
        run_batch(tasks[TASKS[(summary.bodies // N_BODIES) % len(TASKS)]], rng, summary)
        progress(summary.env_steps - done)
    summary.seconds = time.perf_counter() - start
    return summary


def fuzz_worlds(episode: int, seed: int = 0, progress: Callable[[int], object] = lambda _: None) -> Summary:
    """Runs a short batch of every task, and one in its world that reads all there is; else as `fuzz`."""
    rng, summary, start = np.random.default_rng(seed), Summary(), time.perf_counter()
    for task in tasks.values():
        for variant in (task, watching_all(task)):
            done = summary.env_steps
            run_batch(variant, rng, summary, episode)
            progress(summary.env_steps - done)
    summary.seconds = time.perf_counter() - start
    return summary


def main() -> int:
    """Runs from the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--worlds", type=int, metavar="N", help="N env-steps of each task, reading all, in place of --steps"
    )
    arguments = parser.parse_args()
    total = 2 * len(tasks) * N_BODIES * N_COPIES * arguments.worlds if arguments.worlds else arguments.steps
    with tqdm(total=total, unit="env-step", unit_scale=True) as bar:
        if arguments.worlds:
            summary = fuzz_worlds(arguments.worlds, arguments.seed, bar.update)
        else:
            summary = fuzz(arguments.steps, arguments.seed, bar.update)
    print(", ".join(f"{name} {value:,.6g}" for name, value in asdict(summary).items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
