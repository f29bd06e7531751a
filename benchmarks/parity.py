"""Replays recorded roll-outs of the original simulators through the Gymnasium environments, and prints what differs.

    python benchmarks/parity.py RECORDS                    # a folder of .npz roll-outs (and its subfolders)
    python benchmarks/parity.py RECORDS --record PYTHON    # first records new ones, with an interpreter that has evogym

A record holds a body, actions (and stiffness), observations, rewards and positions; see `tests/data/README.md`. Two
readings hang on the last bit in the original, and are compared by their own rules: an orientation near zero (modulo
2 pi, 0.005), and the terrain windows at a COM within 1e-6 voxels of a half (left out).
"""

import argparse
import json
import subprocess
import sys
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from evogymcm.body import Body, sample_body
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.gymnasium import GymnasiumEnv
from evogymcm.envs.tasks import tasks
from evogymcm.envs.tasks.stunts import Flipping
from evogymcm.sim.simulator import Simulator
from evogymcm.sim.world import WorldObject

# Run under the other interpreter: records roll-outs of EvoGym itself, of random bodies with uniform actions.
RECORDER = """
import json, sys
import gymnasium, numpy as np
import evogym.envs
from evogym import get_full_connectivity
jobs = json.loads(sys.stdin.read())
for job in jobs:
    body = np.array(job["body"])
    env = gymnasium.make(job["task"], body=body).unwrapped
    def points():
        return np.array(env.object_pos_at_time(env.get_time(), "robot"))
    observation, _ = env.reset(seed=0)
    rng = np.random.default_rng(job["seed"])
    record = {"obs": [observation], "robot_pos": [points()], "reward": [], "terminated": [], "actions": []}
    for _ in range(job["steps"]):
        action = rng.uniform(0.6, 1.6, env.action_space.shape)
        observation, reward, terminated, _, _ = env.step(action)
        for key, value in (("obs", observation), ("robot_pos", points()), ("reward", reward),
                           ("terminated", terminated), ("actions", action)):
            record[key].append(value)
        if terminated:
            break
    frames = np.arange(len(record["obs"]))
    np.savez_compressed(job["path"], task=job["task"], setting="base", body=body, frames=frames, obs_frames=frames,
                        connections=get_full_connectivity(body), **record)
    print(job["path"], flush=True)
"""
RANDOM_TASKS = ("BidirectionalWalker-v0", "Catcher-v0")  # EvoGym does not say what it drew, so they can't be replayed
ADDED_TASKS = ("CaveCrawler-v1", "HoleCrawler-v0")  # not EvoGym's
EARLY = 30  # steps within which everything must agree to EARLY_BAR
EARLY_BAR, LATE_BAR = 1e-9, 1e-6
ORIENTATION_BAR = 0.005


@dataclass(frozen=True)
class Difference:
    """How far a replay is from its record: the largest differences up to step 30, and to the end."""

    name: str
    task: str
    steps: int
    early: float
    late: float
    same_endings: bool

    @property
    def is_exact(self) -> bool:
        """Whether the first 30 steps and the endings agree."""
        return self.early <= EARLY_BAR and self.same_endings


def make_env(record: Any) -> GymnasiumEnv:
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


def observation_error(engine: TaskEngine, expected: np.ndarray) -> float:
    """Returns the largest difference of the present observation, with the two roundings of the original left out."""
    worst, at, com = 0.0, 0, engine.com[0]
    is_half = abs((com[0] / 0.1) % 1.0 - 0.5) < 1e-6
    for name, part in engine.task.observation(engine.snapshot).items():
        got = part[0]
        error = np.abs(got - expected[at : at + len(got)])
        if "orientation" in name:
            error = np.minimum(error, np.abs(2 * pi - error))
            error = np.where(error < ORIENTATION_BAR, 0.0, error)
        if not (is_half and name in ("floor", "ceiling")):
            worst = max(worst, float(error.max()))
        at += len(got)
    return worst if at == len(expected) else float("inf")


def draw_as_recorded(engine: TaskEngine, record: Any) -> None:
    """Gives an episode the goals or the layout that the original drew, where it draws any."""
    if "goals_x_voxels" in record:
        goals = record["goals_x_voxels"]
        engine.memory["goals"][0, : len(goals)] = 0.1 * goals
        engine.memory["n_goals"][0] = len(goals)
    elif "catcher_offset" in record:
        engine.memory["offset"][0] = record["catcher_offset"]
        engine.simulator.reset(offsets=engine.memory["offset"])
    engine.refresh()


def replay(path: Path) -> Difference:
    """Replays one record."""
    record = np.load(path)
    env = make_env(record)
    engine = env.engine
    env.reset(seed=0)
    draw_as_recorded(engine, record)
    frames = {int(step): row for row, step in enumerate(record["frames"])}
    observed = {int(step): row for row, step in enumerate(record["obs_frames"])}
    turns = np.zeros(len(record["actions"]) + 1)
    turns[0] = engine.snapshot.robot.orientation[0]
    errors = np.zeros(len(record["actions"]) + 1)
    if 0 in observed:
        errors[0] = observation_error(engine, record["obs"][observed[0]])
    if "start_offset" in record:
        engine.simulator.move("robot", tuple(record["start_offset"]), 0)
        engine.refresh()
    same = True
    for step, action in enumerate(record["actions"], 1):
        if str(record["setting"]) == "R":
            action = np.concatenate([action, record["stiffness"][step - 1][record["body"] != 0]])
        _, reward, terminated, _, _ = env.step(action)
        turns[step] = engine.snapshot.robot.orientation[0]
        error = abs(reward - record["reward"][step - 1])
        if isinstance(engine.task, Flipping) and np.minimum(turns, 2 * pi - turns)[step - 1 : step + 1].min() < 0.01:
            error = 0.0 if error < 2 * ORIENTATION_BAR else error  # this reward is a difference of orientations
        if step in frames:
            error = max(error, np.abs(env.points() - record["robot_pos"][frames[step]]).max())
        if step in observed:
            error = max(error, observation_error(engine, record["obs"][observed[step]]))
        same &= terminated == bool(record["terminated"][step - 1])
        errors[step] = error
    return Difference(path.stem, engine.task.id, len(errors) - 1, errors[: EARLY + 1].max(), errors.max(), same)


def replay_small_world(path: Path) -> Difference:
    """Replays a record of objects that drove the original's simulator itself: positions, and whether it stopped."""
    record = np.load(path)
    setting, names = str(record["setting"]), [str(name) for name in record["object_names"]]
    objects = []
    for name in names:
        connections = record.get(f"connections__{name}")
        x, y = record[f"xy__{name}"]
        objects.append(WorldObject(name, record[f"structure__{name}"], (int(x), int(y)), connections))
    simulator = Simulator([tuple(objects)], "mean_stiffness" if setting == "I" else "mean_factor", num_threads=1)
    stiffness = np.clip(record["stiffness"], 0.5, 2.0) if "stiffness" in record else None
    if setting == "I" and stiffness is not None:
        simulator.set_stiffness(stiffness.reshape(1, -1))
    steps = int(record["frames"][-1])
    frames = {int(step): row for row, step in enumerate(record["frames"])}
    errors, is_unstable, actuation = np.zeros(steps + 1), False, np.ones((1, simulator.n_cells))
    for step in range(1, steps + 1):
        if "actions" in record and record["actions"].shape[1]:
            actuation[0, record["actuator_indices"]] = record["actions"][step - 1]
        factors = stiffness[step - 1].reshape(1, -1) if setting == "R" and stiffness is not None else None
        is_unstable |= bool(simulator.step(actuation, factors)[0])
        if step in frames:
            now = np.concatenate([simulator.positions(name) for name in names], axis=1)
            errors[step] = np.abs(now - record["pos"][frames[step]]).max()
    same = is_unstable == bool(record["unstable"])
    return Difference(path.stem, "(small worlds)", steps, errors[: EARLY + 1].max(), errors.max(), same)


def record(python: str, folder: Path, steps: int, seed: int) -> None:
    """Records a roll-out of a random 5x5 body in every task of EvoGym that can be replayed, in the folder."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    jobs = []
    for number, task in enumerate(name for name in tasks if name not in RANDOM_TASKS + ADDED_TASKS):
        path = folder.resolve() / f"recorded_{task}_{seed}.npz"
        body = sample_body((5, 5), rng).grid.tolist()
        jobs.append({"task": task, "body": body, "seed": seed + number, "steps": steps, "path": str(path)})
    command = [python, "-c", RECORDER]
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


def main() -> int:
    """Prints a row a task, worst first, and the records that miss a bar; returns 1 where one misses the early bar."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("records", type=Path, help="folder of .npz roll-outs")
    parser.add_argument("--record", metavar="PYTHON", help="interpreter with evogym==2.0.0, to record with")
    parser.add_argument("--steps", type=int, default=120, help="of a new record")
    parser.add_argument("--seed", type=int, default=0, help="of the new records' bodies and actions")
    arguments = parser.parse_args()
    if arguments.record:
        record(arguments.record, arguments.records, arguments.steps, arguments.seed)
    results = []
    for path in tqdm(sorted(arguments.records.rglob("*.npz")), unit="record"):
        keys = np.load(path)
        if "reward" in keys and str(keys["task"]) in tasks:
            results.append(replay(path))
        elif "pos" in keys and "object_names" in keys:
            results.append(replay_small_world(path))
    if not results:
        print(f"no roll-outs of known tasks under {arguments.records}")
        return 1
    print(f"{'task':24}{'records':>8}{'worst to 30':>14}{'worst to end':>14}{'within 1e-6':>13}{'endings':>9}")
    groups = {task: [r for r in results if r.task == task] for task in {r.task for r in results}}
    for task, rows in sorted(groups.items(), key=lambda item: -max(r.early for r in item[1])):
        early, late = max(r.early for r in rows), max(r.late for r in rows)
        within = sum(r.late <= LATE_BAR for r in rows)
        equal = "equal" if all(r.same_endings for r in rows) else "DIFFER"
        print(f"{task:24}{len(rows):8}{early:14.1e}{late:14.1e}{within:9}/{len(rows):<3}{equal:>9}")
    missed = [r for r in results if not r.is_exact]
    within = sum(r.late <= LATE_BAR for r in results)
    exact = len(results) - len(missed)
    print(f"{len(results)} records: {exact} within {EARLY_BAR:g} for {EARLY} steps with equal endings")
    print(f"{within} ({within / len(results):.1%}) within {LATE_BAR:g} to the end")
    for r in sorted((r for r in results if not r.is_exact or r.late > LATE_BAR), key=lambda r: -r.early):
        print(f"  {r.name}: {r.early:.1e} to step {EARLY}, {r.late:.1e} to {r.steps}, endings equal: {r.same_endings}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
