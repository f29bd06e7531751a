"""Replays recorded roll-outs of the original simulators, and prints where a bit differs.

    python benchmarks/parity.py RECORDS                    # a folder of .npz roll-outs (and its subfolders)
    python benchmarks/parity.py RECORDS --record PYTHON    # first records new ones, with an interpreter that has evogym

A record holds a body, actions (and stiffness), observations, rewards, positions and velocities; see
`tests/data/README.md` and `tests/data/tasks/README.md`. Tasks are replayed through the Gymnasium environments.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from _record_evogym import digest, draw_actions, library
from tqdm import tqdm

from evogymcm.body import Body, sample_body
from evogymcm.envs import GymnasiumEnv, TaskEngine
from evogymcm.envs.tasks import tasks
from evogymcm.sim.constants import FIXED, RIGID
from evogymcm.sim.simulator import Simulator
from evogymcm.sim.world import ROBOT, WorldObject

ADDED_TASKS = ("CaveCrawler-v1", "HoleCrawler-v0")  # not EvoGym's
BAR = 1e-12  # an orientation after a shift by hand is off by a tenth of this: its zero is rounded otherwise
SMALL_WORLDS = "(small worlds)"
# The parts of a record, and where it has the env-steps at which they are kept.
_FRAMES = {
    "pos": "frames",
    "vel": "vel_frames",
    "robot_pos": "frames",
    "robot_vel": "vel_frames",
    "other_pos": "other_frames",
    "other_vel": "other_frames",
    "obs": "obs_frames",
    "reward": "reward_frames",
    "ended": "ended_frames",
}
Record = dict[str, Any]
Parts = Mapping[str, Callable[[], Any]]  # what can be read after an env-step, by the names in the record


@dataclass
class Replay:
    """How far a replay is from its record.

    Attributes:
        name: The record's.
        task: Its task, or SMALL_WORLDS.
        steps: Env-steps compared.
        worst: The largest difference of any number that the record holds.
        first: For each part that differs in a bit, the env-step of the first difference.
        same_digests: Whether all digests agree, where it holds some.
    """

    name: str
    task: str
    steps: int = 0
    worst: float = 0.0
    first: dict[str, int] = field(default_factory=dict)
    same_digests: bool = True

    @property
    def is_identical(self) -> bool:
        """Whether every bit agrees."""
        return not self.first

    @property
    def is_equal(self) -> bool:
        """Whether all numbers agree to BAR, and endings and digests exactly."""
        return self.worst <= BAR and self.same_digests and "ended" not in self.first

    def compare(self, record: Record, step: int, parts: Parts) -> None:
        """Compares what the record has of an env-step."""
        self.steps = max(self.steps, step)
        for part, read in parts.items():
            row = record["rows"].get(part, {}).get(step)
            digests = record.get(f"digest_{part}")
            if row is None and digests is None:
                continue
            got = np.asarray(read(), np.float64)
            if digests is not None and digests[step] != digest(got):
                self.same_digests = False
                self.first.setdefault(part, step)
            if row is not None:
                expected = np.asarray(record[part][row], np.float64)
                if not np.array_equal(got, expected):
                    self.first.setdefault(part, step)
                    is_like = got.shape == expected.shape
                    self.worst = max(self.worst, float(np.abs(got - expected).max()) if is_like else np.inf)


def load(path: Path) -> Record:
    """Returns a record with its actions, and the rows of each part by env-step."""
    with np.load(path) as file:
        record = dict(file)
    if "terminated" in record:
        record["ended"] = record["terminated"]
    if "seed" in record:  # actions are drawn anew
        steps = len(record["digest_pos"]) - 1
        n = np.isin(record["body"], (3, 4)).sum() if "body" in record else len(record["actuator_indices"])
        record["actions"] = draw_actions(int(record["seed"]), steps, int(n))
    for part in ("reward", "ended"):
        record[f"{part}_frames"] = np.arange(1, len(record.get(part, ())) + 1)
    rows = {part: key for part, key in _FRAMES.items() if part in record}
    record["rows"] = {part: {int(s): row for row, s in enumerate(record[key])} for part, key in rows.items()}
    return record


def make_env(record: Record) -> GymnasiumEnv:
    """Returns the environment that a record was made in."""
    setting = str(record["setting"])
    body = Body(record["body"], record["connections"])
    stiffness = np.clip(record["stiffness"], 0.5, 2.0) if setting == "I" else None
    return GymnasiumEnv(
        str(record["task"]),
        body,
        material="reactive" if setting == "R" else "invariant",
        stiffness=stiffness,
        edge_rule="mean_stiffness" if setting == "I" else "mean_factor",
    )


def draw_as_recorded(engine: TaskEngine, record: Record) -> None:
    """Gives an episode the goals or the layout that the original drew, where it draws any."""
    if "goals_x_voxels" in record:
        goals = record["goals_x_voxels"]
        engine.memory["goals"][0, : len(goals)] = 0.1 * goals
        engine.memory["n_goals"][0] = len(goals)
    elif "catcher_offset" in record:
        engine.memory["offset"][0] = record["catcher_offset"]
        engine.simulator.reset(offsets=engine.memory["offset"])
    engine.refresh()


def _simulator_parts(simulator: Simulator, record: Record) -> dict[str, Callable[[], Any]]:
    names = [str(name) for name in record.get("object_names", ())]
    others = record.get("other_index", ())

    def all_of(read: Callable[[str], np.ndarray]) -> np.ndarray:
        return np.concatenate([read(name) for name in names], axis=1)

    parts: dict[str, Callable[[], Any]] = {}
    for key, read in (("pos", simulator.positions), ("vel", simulator.velocities)):
        parts[f"robot_{key}"] = lambda read=read: read(ROBOT)
        parts[key] = lambda read=read: all_of(read)
        parts[f"other_{key}"] = lambda read=read: all_of(read)[:, others]
    return parts


def _task_steps(record: Record) -> Iterator[tuple[int, Parts]]:
    """Yields what can be read before the first env-step of a task, and after each."""
    env = make_env(record)
    engine = env.engine
    env.reset(seed=0)
    draw_as_recorded(engine, record)
    parts = _simulator_parts(engine.simulator, record)
    assert engine.flat is not None
    observation, reward, terminated = engine.flat[0], 0.0, False
    yield 0, {"obs": lambda: observation, "reward": lambda: reward}
    if "start_offset" in record:
        engine.simulator.move(ROBOT, tuple(record["start_offset"]), 0)
        engine.refresh()
    yield 0, parts
    parts |= {"obs": lambda: observation, "reward": lambda: reward, "ended": lambda: terminated}
    for step, action in enumerate(record["actions"], 1):
        if str(record["setting"]) == "R":
            action = np.concatenate([action, record["stiffness"][step - 1][record["body"] != 0]])
        observation, reward, terminated, _, _ = env.step(action)
        yield step, parts


def _world_steps(record: Record) -> Iterator[tuple[int, Parts]]:
    """Yields the same of objects that drove the original's simulator itself."""
    setting, objects = str(record["setting"]), []
    for name in (str(name) for name in record["object_names"]):
        x, y = record[f"xy__{name}"]
        cells, joined = record[f"structure__{name}"], record.get(f"connections__{name}")
        objects.append(WorldObject(name, cells, (int(x), int(y)), joined))
    simulator = Simulator([tuple(objects)], "mean_stiffness" if setting == "I" else "mean_factor", num_threads=1)
    stiffness = np.clip(record["stiffness"], 0.5, 2.0) if "stiffness" in record else None
    if setting == "I" and stiffness is not None:
        simulator.set_stiffness(stiffness.reshape(1, -1))
    parts, actuation = _simulator_parts(simulator, record), np.ones((1, simulator.n_cells))
    yield 0, parts
    steps = int(record["frames"][-1]) if "digest_pos" not in record else len(record["digest_pos"]) - 1
    is_unstable = False
    for step in range(1, steps + 1):
        if "actions" in record and record["actions"].shape[1]:
            actuation[0, record["actuator_indices"]] = record["actions"][step - 1]
        factors = stiffness[step - 1].reshape(1, -1) if setting == "R" and stiffness is not None else None
        is_unstable |= bool(simulator.step(actuation, factors)[0])
        yield step, parts
    record["ended"], record["rows"]["ended"] = [record["unstable"]], {steps: 0}
    yield steps, {"ended": lambda: is_unstable}


def replay(path: Path, last: int | None = None) -> Replay:
    """Replays one record, up to the env-step `last` where it is given."""
    record = load(path)
    is_task = "task" in record
    result = Replay(path.stem, str(record["task"]) if is_task else SMALL_WORLDS)
    for step, parts in (_task_steps if is_task else _world_steps)(record):
        if last is not None and step > last:
            break
        result.compare(record, step, parts)
    return result


def loose_blocks(rng: np.random.Generator) -> list[tuple[str, list[list[int]], tuple[int, int]]]:
    """Returns a small world: a robot, and rigid blocks that fall on it and on each other in a box."""
    body = sample_body((4, 4), rng).grid.tolist()
    walls = [("floor", (1, 16), (0, 0)), ("left", (7, 1), (0, 1)), ("right", (7, 1), (15, 1))]
    shapes = [((1, 1), (1, 2), (2, 1), (2, 2))[rng.integers(4)] for _ in range(12)]
    blocks = [
        (f"block_{i:02}", np.full(shape, RIGID).tolist(), (int(2 + 3 * (i % 4) + rng.integers(2)), 6 + 3 * (i // 4)))
        for i, shape in enumerate(shapes)
    ]
    return [(ROBOT, body, (6, 1)), *blocks, *((name, np.full(shape, FIXED).tolist(), xy) for name, shape, xy in walls)]


def record(python: str, folder: Path, steps: int, seed: int, names: list[str]) -> None:
    """Records an episode of a random 5x5 body in each of some tasks, and a world of loose blocks, in the folder."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    jobs: list[dict[str, Any]] = []
    for name in (SMALL_WORLDS, *names):
        job: dict[str, Any] = {"seed": seed + len(jobs), "steps": steps}
        if name == SMALL_WORLDS:
            job["objects"] = loose_blocks(rng)
        else:
            job |= {"task": name, "body": sample_body((5, 5), rng).grid.tolist()}
        stem = "loose_blocks" if name == SMALL_WORLDS else name.lower().replace("-", "_")
        jobs.append(job | {"path": str(folder.resolve() / f"{stem}_{seed}.npz")})
    command = [python, str(Path(__file__).with_name("_record_evogym.py"))]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None  # both are pipes
        assert process.stdout is not None
        process.stdin.write(json.dumps(jobs))
        process.stdin.close()
        for line in tqdm(process.stdout, total=len(jobs), unit="record"):
            if not line.strip().endswith(".npz"):
                tqdm.write(line.rstrip(), file=sys.stderr)
    if process.returncode:
        raise RuntimeError(f"{python} could not record with evogym: exit status {process.returncode}")


def is_roll_out(path: Path) -> bool:
    """Whether a file is a roll-out that can be replayed."""
    with np.load(path) as keys:
        return "digest_pos" in keys or "reward" in keys or {"pos", "object_names"} <= set(keys)


def main() -> int:
    """Prints a row a task, and the records that differ in a bit; returns 1 where one differs by more than BAR."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("records", type=Path, help="folder of .npz roll-outs")
    parser.add_argument("--record", metavar="PYTHON", help="interpreter with evogym==2.0.0, to record with")
    parser.add_argument("--steps", type=int, default=500, help="of a new record")
    parser.add_argument("--seed", type=int, default=0, help="of the new records' bodies and actions")
    parser.add_argument("--tasks", nargs="+", metavar="ID", help="of the new records; all of EvoGym's by default")
    arguments = parser.parse_args()
    if arguments.record:
        names = arguments.tasks or [name for name in tasks if name not in ADDED_TASKS]
        record(arguments.record, arguments.records, arguments.steps, arguments.seed, names)
    paths = [path for path in sorted(arguments.records.rglob("*.npz")) if is_roll_out(path)]
    if not paths:
        print(f"no roll-outs under {arguments.records}")
        return 1
    if any(int(np.load(path).get("library", library())) != library() for path in paths):
        print("tanh or acos of this C library are not the recorder's: last digits will differ")
    results = [replay(path) for path in tqdm(paths, unit="record")]
    print(f"{'task':24}{'records':>8}{'env-steps':>11}{'bit-identical':>15}{'worst':>10}")
    for task in sorted({r.task for r in results}):
        rows = [r for r in results if r.task == task]
        identical, worst = sum(r.is_identical for r in rows), max(r.worst for r in rows)
        print(f"{task:24}{len(rows):8}{sum(r.steps for r in rows):11}{identical:11}/{len(rows):<3}{worst:10.1e}")
    identical, equal = sum(r.is_identical for r in results), sum(r.is_equal for r in results)
    print(f"{len(results)} records: {identical} bit-identical to the end, {equal} equal to {BAR:g} to the end")
    for r in (r for r in results if not r.is_identical):
        parts = ", ".join(f"{part} from env-step {step}" for part, step in r.first.items())
        print(f"  {r.name}: differs by {r.worst:.1e}: {parts}")
    return 0 if equal == len(results) else 1


if __name__ == "__main__":
    sys.exit(main())
