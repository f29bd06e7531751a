"""Measures training end to end: env-steps per second of PPO, updates included, alone or in turn with the reference's.

    python benchmarks/training_speed.py --against-evogym PATH/TO/PYTHON
    python benchmarks/training_speed.py --threads 2 --torch-threads 2 --json

Ours is one run with the default `PPOConfig`. The reference is Stable-Baselines3's PPO on EvoGym with the settings of
EvoGym's and EvoGymCM's scripts: one world, rollouts of 128 steps, mini-batches of 4. EvoGym has no stiffness, so both
of our settings are compared with the same program. Both train whole rollouts, and both leave evaluations out.
"""

import json
import statistics
import subprocess
import time
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import tyro
from _runners import EvoGym, Runner
from throughput import STANDARD_BODY, in_turn, progress

from evogymcm.algos import PPOConfig, keep_freed_memory
from evogymcm.algos.learning import Trainer
from evogymcm.algos.runs import find_origin
from evogymcm.body import Body, as_body
from evogymcm.envs import SoftRobotEnv

# What EvoGym's and EvoGymCM's scripts give to Stable-Baselines3.
REFERENCE_PPO = {
    "learning_rate": 2.5e-4,
    "n_steps": 128,
    "batch_size": 4,
    "n_epochs": 4,
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "clip_range": 0.1,
    "ent_coef": 0.01,
    "vf_coef": 0.5,
    "max_grad_norm": 0.5,
}


@dataclass(frozen=True)
class Options:
    """Command line.

    Attributes:
        task: task to learn.
        body: rows of cells, or a robot's name.
        materials: settings to measure, one after another; "reactive" learns stiffness too.
        threads: threads of the simulator.
        ppo: settings of our run, torch's threads among them.
        against_evogym: a Python interpreter that has evogym 2.0.0 and stable-baselines3, to compare with.
        reference_threads: torch's threads in the reference; by default torch chooses.
        pairs: measurements of each program; their median counts.
        seconds: least length of one measurement, which ends with a whole rollout and its update.
        json: print one JSON object a row instead of a table.
    """

    task: str = "Walker-v0"
    body: str = STANDARD_BODY
    materials: tuple[Literal["invariant", "reactive"], ...] = ("invariant", "reactive")
    threads: int = 1
    ppo: tyro.conf.OmitArgPrefixes[PPOConfig] = field(default_factory=PPOConfig)
    against_evogym: Path | None = None
    reference_threads: int | None = None
    pairs: int = 5
    seconds: float = 10.0
    json: bool = False

    def __post_init__(self) -> None:
        for name in ("threads", "reference_threads", "pairs", "seconds"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise ValueError(f"{name}: got {value}, must be positive")
        if not self.materials:
            raise ValueError("materials: got none, allowed are 'invariant', 'reactive' and both")


class Ours(Runner):
    """A training run; where it comes to its end, the same run again with the next seed."""

    def __init__(self, options: Options, body: Body, material: str) -> None:
        self.make_env = partial(SoftRobotEnv, options.task, bodies=body, material=material, num_threads=options.threads)
        self.epochs: list[float] = []  # of each update: the limit on KL divergence may end it early
        self.trainer = Trainer(self.make_env, options.ppo)

    def run(self, seconds: float) -> float:
        """Returns env-steps per second over at least so many seconds."""
        count, start = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - start) < seconds:
            if self.trainer.is_finished:
                self.trainer.close()
                self.trainer = Trainer(self.make_env, replace(self.trainer.config, seed=self.trainer.config.seed + 1))
            before = self.trainer.env_steps
            self.epochs.append(self.trainer.update()["epochs"])
            count += self.trainer.env_steps - before
        return count / elapsed

    def close(self) -> None:
        """Releases the environment."""
        self.trainer.close()


# Runs under an interpreter that has evogym and stable-baselines3: writes its versions, then reads lines of seconds and
# writes lines of env-steps per second. The policy is small: it is faster on the CPU also where there is a GPU.
_REFERENCE = """
import json, os, platform, sys, time
answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # the simulator greets on stdout
from importlib.metadata import PackageNotFoundError, version
import numpy as np
import torch
import evogym.envs
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

given = json.loads(sys.argv[1])
if given["threads"] is not None:
    torch.set_num_threads(given["threads"])
body = {"body": np.array(given["body"]), "connections": np.array(given["connections"])}
env = make_vec_env(given["task"], n_envs=1, seed=given["seed"], env_kwargs=body)
model = PPO("MlpPolicy", env, seed=given["seed"], device="cpu", **given["ppo"])
found = {"python": platform.python_version(), "torch_threads": torch.get_num_threads()}
for package in ("evogym", "stable-baselines3", "torch", "numpy"):
    try:
        found[package] = version(package)
    except PackageNotFoundError:
        found[package] = None
print("ready", file=answers, flush=True)
print(json.dumps(found), file=answers, flush=True)
for line in sys.stdin:
    seconds, before, start = float(line), model.num_timesteps, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds:
        model.learn(model.n_steps, reset_num_timesteps=False)  # one rollout and its update; episodes go on
    print((model.num_timesteps - before) / elapsed, file=answers, flush=True)
"""


class Reference(EvoGym):
    """Stable-Baselines3's PPO on EvoGym's own environment, in its own process."""

    def __init__(self, python: Path, options: Options, body: Body) -> None:
        given = {
            "task": options.task,
            "seed": options.ppo.seed,
            "threads": options.reference_threads,
            "ppo": REFERENCE_PPO,
            "body": body.grid.tolist(),
            "connections": body.connections.tolist(),
        }
        command = [str(python), "-c", _REFERENCE, json.dumps(given)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        if self._answer() != "ready":
            raise RuntimeError(f"{python}: evogym and stable-baselines3 could not be run there, see the messages above")
        self.versions: dict[str, Any] = json.loads(self._answer())


def measure(material: str, options: Options) -> dict[str, Any]:
    """Returns one row."""
    body = as_body(options.body)
    with ExitStack() as stack:
        ours = Ours(options, body, material)
        stack.callback(ours.close)
        runners: list[Runner] = [ours]
        if options.against_evogym:
            reference = Reference(options.against_evogym, options, body)
            stack.callback(reference.close)
            runners.append(reference)
        rates = in_turn(runners, options.pairs, options.seconds)
    row: dict[str, Any] = {
        "task": options.task,
        "material": material,
        "body": body.text,
        "worlds": options.ppo.num_worlds,
        "threads": options.threads,
        "torch_threads": options.ppo.torch_threads,
        "epochs": round(statistics.mean(ours.epochs), 2),
        "env_steps_per_s": round(statistics.median(rates[0]), 1),
    }
    if options.against_evogym:
        ratios = [mine / theirs for mine, theirs in zip(*rates, strict=True)]
        row |= {
            "reference_env_steps_per_s": round(statistics.median(rates[1]), 1),
            "ratio": round(statistics.median(ratios), 2),
            "pairs": [round(ratio, 2) for ratio in ratios],
            "reference_ppo": REFERENCE_PPO,
            "reference_versions": reference.versions,
        }
    return row


def table_line(row: dict[str, Any]) -> str:
    """Returns a row as text; the comparison stands at its end."""
    text = f"{row['task']:<18} {row['material']:<10} {row['body']:<30} {row['worlds']:>4} worlds "
    text += f"{row['threads']}+{row['torch_threads']} threads {row['env_steps_per_s']:>9.0f}/s"
    text += f" ({row['epochs']:.1f} epochs an update)"
    if "ratio" in row:
        text += f"   reference {row['reference_env_steps_per_s']:>6.0f}/s   x{row['ratio']:.1f}"
    return text


def main(options: Options) -> None:
    """Measures the settings, and prints a row for each."""
    keep_freed_memory()  # as `evogymcm train` does
    origin = find_origin()
    progress(f"{origin['machine']['cpu']}, {origin['machine']['cores']} cores")
    for material in options.materials:
        progress(f"{options.task}, {material}, {options.ppo.num_worlds} worlds")
        row = measure(material, options)
        print(json.dumps(row | origin) if options.json else table_line(row), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
