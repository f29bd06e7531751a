"""A policy that learns in a process of its own while its robot is watched."""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from evogymcm.algos.learning.config import PPOConfig, TrainConfig
from evogymcm.algos.runs.folder import RunFolder
from evogymcm.algos.runs.older import present_settings
from evogymcm.algos.runs.origin import usable_cores
from evogymcm.body import as_body, check_stiffness
from evogymcm.envs.dealing import BodySpec
from evogymcm.envs.tasks import Task, as_task
from evogymcm.envs.terrain import walking_task
from evogymcm.sim.world import World
from evogymcm.studio.driving import STILL, Driver
from evogymcm.studio.processes import Job, Tell

PPO = PPOConfig(total_steps=300_000, eval_interval=10_000)  # a minute or two, with a new picture every few seconds
_INITIAL = "initial"


class Learning(Job):
    """Trains a policy for one design with PPO, in a process of its own.

    The folder is one of `train`: `evogymcm train`, `watch` and `report` take it too.

        learning = Learning("runs/first", "HHH/V.V")
        learning.start()
        learning.status()["curve"]
        player.use(learning.policy)
        learning.stop()

    Args:
        folder: Of the run; made when it starts.
        body: Anything that `as_body` takes.
        stiffness: (rows, columns) in [0.5, 2]; None for 1. In the reactive setting None.
        task: The id of a task, a `World` to walk in, or a world's file, of which the folder gets a copy.
        material: "invariant" or "reactive".
        ppo: Settings; by default 300,000 env-steps with an evaluation every 10,000.
        initial: A policy to begin with, of this task, or of one with the same features, and any body: "baseline", the
            folder of a run, one of its files, or a `SavedPolicy`. The network is then of its kind and size. By default
            the package's policy of the task, and random weights where there is none.

    Raises:
        ValueError: A setting is out of range, the design is not valid, or it cannot begin with that policy.
    """

    kind = "train"
    _task: Task | None = None
    _initial: Driver | None = None

    def __init__(
        self,
        folder: str | os.PathLike[str],
        body: BodySpec,
        stiffness: Any = None,
        task: str | os.PathLike[str] | World = "Walker-v0",
        material: str = "invariant",
        ppo: PPOConfig | None = None,
        initial: Any = None,
    ) -> None:
        self._task = walking_task(task) if isinstance(task, World) else as_task(task)
        ppo = PPO if ppo is None else ppo
        if initial is not None:
            self._initial = Driver(initial, self._task, material)
            ppo = replace(ppo, **_network_of(self._initial))
        field = None if stiffness is None else (check_stiffness(stiffness, as_body(body)).tolist(),)
        config = TrainConfig(
            self._own(folder, task),
            (as_body(body),),  # type: ignore[arg-type]
            material,  # type: ignore[arg-type]
            field,
            ppo=ppo,
        )
        super().__init__(folder, config)

    @classmethod
    def read_config(cls, saved: Mapping[str, Any]) -> TrainConfig:
        """Returns the settings of a training run."""
        saved = present_settings(saved)
        return TrainConfig(**{**saved, "ppo": PPOConfig(**saved["ppo"])})

    def check(self) -> None:
        """Raises a ValueError where the task is unknown, or the design does not fit into its world."""
        bodies, fields = self.config.designs()
        task = self._task or as_task(self.config.task)
        driver = self._initial or Driver(STILL, task, self.config.material)
        driver.make(bodies[0], None if fields is None else fields[0], 0)

    def _prepare(self, run: RunFolder) -> None:
        super()._prepare(run)
        if self._initial is not None and self._initial.saved is not None:
            state = self._initial.saved.state
            run.save(_INITIAL, {name: state[name] for name in ("form", "actor", "critic")})

    def work(self, run: RunFolder, should_stop: Callable[[], bool], tell: Tell) -> bool:
        """Trains to the end, or until it should stop."""
        from evogymcm.algos.learning.memory import keep_freed_memory
        from evogymcm.algos.learning.training import train

        keep_freed_memory()
        threads = max(1, usable_cores() - 1)  # one is left for those who look on
        initial = run.load(_INITIAL)
        return train(self.config, run=run, should_stop=should_stop, initial=initial, num_threads=threads).finished

    @property
    def has_finished(self) -> bool:
        """Whether the folder holds the last policy."""
        return (self.folder / "final.pt").is_file()

    @property
    def policy(self) -> Path | None:
        """The newest policy, which `Player` takes; None before the first evaluation."""
        names = ("final.pt", "checkpoint.pt")
        return next((self.folder / name for name in names if (self.folder / name).is_file()), None)

    def progress(self, told: Mapping[str, Any]) -> dict[str, Any]:
        """Returns how far it is.

        | key | what |
        | --- | --- |
        | `env_steps`, `total` | done so far, and all |
        | `curve` | (env-steps, score) of the evaluations, the untrained policy's first |
        | `seconds` | of training and evaluations so far |
        | `policy`, `policy_time` | file of the newest policy, None before there is one, and when it was written |
        """
        rows, policy = self.files.rows(), self.policy
        return {
            "env_steps": rows[-1]["env_steps"] if rows else 0,
            "total": self.config.ppo.total_steps,
            "curve": [(row["env_steps"], row["score"]) for row in rows if row.get("score") is not None],
            "seconds": next((row["seconds"] for row in reversed(rows) if "seconds" in row), 0.0),
            "policy": None if policy is None else str(policy),
            "policy_time": None if policy is None else policy.stat().st_mtime,
        }


def _network_of(driver: Driver) -> dict[str, Any]:
    """Returns the settings of PPO that make a network like a policy's; ValueError where a run cannot begin with it."""
    form = driver.saved.state["form"] if driver.saved is not None else None
    if form is None or form.get("copies") is not None:
        raise ValueError(f"initial: got {'a gait' if form is None else 'several policies'}, expected one policy")
    return {name: form[name] for name in ("network", "hidden", "context") if name in form}
