"""Records roll-outs of EvoGym itself, under an interpreter that has `evogym==2.0.0`; `parity.py` starts and replays it.

Jobs are read from standard input as JSON. A record is small: its actions are drawn anew from its seed, and it holds
digests of every env-step, with positions and observations of every hundredth. Positions and velocities are those of
the simulator itself: EvoGym's Python layer divides by 0.1 and multiplies again, which changes last bits.
"""

import json
import math
import random
import sys
import zlib
from typing import Any

import numpy as np

EVERY = 100  # env-steps between those of which numbers are kept
_KEPT = {"pos": "frames", "obs": "obs_frames"}  # parts, and where a record has their env-steps


def digest(values: Any) -> int:
    """Returns a number that tells the bits of float64 values; both zeros count as one."""
    return zlib.crc32(np.ascontiguousarray(np.asarray(values, np.float64) + 0.0).tobytes())


def draw_actions(seed: int, steps: int, n_actuators: int) -> np.ndarray:
    """Returns (steps, actuators) uniform actions."""
    return np.random.default_rng(seed).uniform(0.6, 1.6, (steps, n_actuators))


def library() -> int:
    """Returns a digest of the C library's tanh and acos, the only functions whose bits the processor does not fix."""
    rng = np.random.default_rng(0)  # numpy's own functions are not the same everywhere: ldexp is exact
    slips, cosines = np.ldexp(rng.uniform(0.5, 1, 20_000), rng.integers(-30, 6, 20_000)), rng.uniform(-1, 1, 20_000)
    return digest([math.tanh(x) for x in slips] + [math.acos(x) for x in cosines])


class Rows:
    """Digests of every env-step, and some of the numbers of every hundredth."""

    def __init__(self) -> None:
        self._rows: dict[str, list[Any]] = {}
        self._steps = 0

    def add(self, **parts: Any) -> None:
        """Adds the numbers of the next env-step, under their names in the record."""
        for part, values in parts.items():
            self._rows.setdefault(f"digest_{part}", []).append(digest(values))
            if self._steps % EVERY == 0 and part in _KEPT:
                self._rows.setdefault(part, []).append(values)
                self._rows.setdefault(_KEPT[part], []).append(self._steps)
        self._steps += 1

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns the arrays of the record."""
        return {name: np.array(rows, np.uint32 if "digest" in name else None) for name, rows in self._rows.items()}


def _state(sim: Any, names: list[str]) -> dict[str, np.ndarray]:
    from evogym.simulator_cpp import Sim

    time = sim.get_time()
    readers = {"pos": Sim.object_pos_at_time, "vel": Sim.object_vel_at_time}
    return {key: np.concatenate([read(sim, time, name) for name in names], axis=1) for key, read in readers.items()}


def record_task(job: dict[str, Any]) -> dict[str, Any]:
    """Returns the record of an episode of a task."""
    import evogym.envs
    import gymnasium

    body = np.array(job["body"])
    random.seed(job["seed"])  # EvoGym draws goals and places from global generators
    np.random.seed(job["seed"])  # noqa: NPY002
    env = gymnasium.make(job["task"], body=body).unwrapped
    observation, _ = env.reset()
    drawn = {}
    if hasattr(env, "offsetx"):
        drawn["catcher_offset"] = [env.offsetx, env.offsety]
    if hasattr(env, "requirements"):
        goals = env.requirements["robot_com_pos_initial"]  # texts such as "Walk to x = 23"
        drawn["goals_x_voxels"] = [int(goal.split("=")[1]) for goal in goals]
    names = list(env.world.objects)
    rows, terminated = Rows(), []
    rows.add(obs=observation, reward=0.0, **_state(env.sim, names))
    for action in draw_actions(job["seed"], job["steps"], *env.action_space.shape):
        observation, reward, is_over, _, _ = env.step(action)
        rows.add(obs=observation, reward=reward, **_state(env.sim, names))
        terminated.append(is_over)
        if is_over:
            break
    connections = evogym.get_full_connectivity(body)
    own = {"task": job["task"], "body": body, "connections": connections, "terminated": terminated}
    return {"object_names": names, **own, **drawn, **rows.arrays()}


def record_world(job: dict[str, Any]) -> dict[str, Any]:
    """Returns the record of a world of one's own, the robot first."""
    from evogym import EvoSim, EvoWorld

    world, own = EvoWorld(), {}
    for name, grid, (x, y) in job["objects"]:
        world.add_from_array(name, np.array(grid), x, y)
        own |= {f"structure__{name}": grid, f"xy__{name}": (x, y)}
    sim = EvoSim(world)
    sim.reset()
    names = [name for name, _, _ in job["objects"]]
    actuators = np.ravel(sim.get_actuator_indices("robot"))
    rows, is_unstable = Rows(), False
    rows.add(**_state(sim, names))
    for action in draw_actions(job["seed"], job["steps"], len(actuators)):
        sim.set_action("robot", action)
        is_unstable = sim.step()
        rows.add(**_state(sim, names))
        if is_unstable:
            break
    return {"object_names": names, "actuator_indices": actuators, "unstable": is_unstable, **own, **rows.arrays()}


if __name__ == "__main__":
    for job in json.load(sys.stdin):
        record = record_task(job) if "task" in job else record_world(job)
        fixed = {"setting": "base", "seed": job["seed"], "library": library()}
        np.savez_compressed(job["path"], **fixed, **record)
        print(job["path"], flush=True)
