"""Puts the policy of a run on random bodies into the package, with its record: what `evogymcm.baseline` returns.

    evogymcm train Walker-v0 --random-bodies 5 5 --hidden 64 --run runs/walker
    python benchmarks/store_baseline.py runs/walker            # its last policy
    python benchmarks/store_baseline.py runs/walker/best.pt    # the best of its evaluations, on the held-out bodies too

The policy plays on the held-out bodies first, from several starts; what it reaches there stands in the record.
"""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # instead of this file's folder: `benchmarks` is a package

import json
import shlex

import numpy as np

from benchmarks.experiments.options import words_of
from evogymcm._files import write_atomic
from evogymcm.algos import PPOConfig, RunFolder, RunRecord, TrainConfig, evaluate, load_policy
from evogymcm.algos.baselines import FOLDER
from evogymcm.algos.learning.bodies import N_HELD_OUT, held_out_bodies
from evogymcm.algos.learning.threads import limited_threads
from evogymcm.algos.runs.older import present_settings

LARGEST = 200_000  # bytes of weights


@dataclass(frozen=True)
class Options:
    """Command line.

    Attributes:
        run: folder of the run, or one of its policies.
        starts: from how many starts each body is played.
        folder: where the baseline goes; one of the same task and setting is replaced.
    """

    run: Annotated[Path, tyro.conf.Positional]
    starts: int = 8
    folder: Path = FOLDER


def store(run: Path, starts: int = 8, folder: Path = FOLDER) -> Path:
    """Writes a policy and its record, and returns the record's path.

    Raises:
        ValueError: It is not a shared policy that was trained on random bodies, or its weights are too large.
    """
    saved = load_policy(run)
    files = RunFolder.open(saved.path.parent)
    config, told = read_config(files.config), RunRecord.read(files.path)
    if config.random_bodies is None or config.ppo.network != "voxel" or config.work_weight not in (None, (0.0, 0.0)):
        raise ValueError(f"run: {run} is no training on random bodies, with a policy for all and for the task's reward")
    arrays = {
        f"{part}/{name}": np.asarray(values)
        for part in ("actor", "critic")
        for name, values in saved.state[part].items()
    }
    size = sum(values.nbytes for values in arrays.values())
    if size > 0.9 * LARGEST:  # the file has their names too
        raise ValueError(
            f"run: the weights of {saved.path} have {size:,} bytes, at most {0.9 * LARGEST:,.0f} are allowed"
        )

    def write_weights(part: Path) -> None:
        with part.open("wb") as file:
            np.savez(file, **arrays)

    row, form = saved.state["row"], saved.state["form"]
    bodies = held_out_bodies(config.random_bodies)
    fields = None if config.stiffness is None else [np.where(body.occupancy, config.stiffness, 1.0) for body in bodies]
    env = saved.make_env(starts * N_HELD_OUT, bodies=bodies, stiffness=fields)
    try:
        with limited_threads(1):  # idle threads of torch would take time from those of the simulator
            result = evaluate(saved.module(env), env, starts)
    finally:
        env.close(raise_if_closed=False)
    record = {
        **{name: value for name, value in asdict(config).items() if name not in ("bodies", "initial", "ppo")},
        "env_steps": row["env_steps"],
        "seconds": row["seconds"],
        "seed": config.ppo.seed,
        "policy": saved.path.stem,
        "score": float(result.score.mean()),
        "robust_score": float(result.robust.mean()),
        "spread": float(result.spread.mean()) if starts > 1 else None,
        "starts": starts,
        "robust_scores": [round(score, 4) for score in result.robust.tolist()],
        "command": command_of(config),
        "ppo": asdict(config.ppo),
        "form": form,
        "origin": told.origin,
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{config.task}-{config.material}.json"
    write_atomic(path.with_suffix(".npz"), write_weights)
    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    write_atomic(path, lambda part: part.write_text(text, encoding="utf-8"))  # last: there is a baseline where it is
    return path


def read_config(saved: Any) -> TrainConfig:
    """Returns the settings of a training run."""
    saved = present_settings(saved)
    return TrainConfig(**{**saved, "ppo": PPOConfig(**saved["ppo"])})


def command_of(config: TrainConfig) -> str:
    """Returns what repeats a training on random bodies."""
    assert config.random_bodies is not None
    words = ["evogymcm", "train", config.task, "--random-bodies", *map(str, config.random_bodies)]
    for name in ("pool", "material", "stiffness", "edge_rule", "work_weight", "initial"):
        value = getattr(config, name)
        if value != getattr(TrainConfig(config.task), name):
            words += [f"--{name.replace('_', '-')}", *map(str, value if isinstance(value, tuple) else (value,))]
    return shlex.join(words + words_of(config.ppo, PPOConfig()))


if __name__ == "__main__":
    options = tyro.cli(Options, prog="store_baseline.py", description=__doc__)
    written = store(options.run, options.starts, options.folder)
    told = json.loads(written.read_text(encoding="utf-8"))
    print(
        f"{written}: {told['robust_score']:.3f} on {N_HELD_OUT} held-out bodies after {told['env_steps']:,} env-steps"
    )
    print(told["command"])
