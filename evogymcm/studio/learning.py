"""A policy that learns in a process of its own while its robot is watched."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from evogymcm.algos.learning.config import PPOConfig, TrainConfig
from evogymcm.algos.runs.folder import RunFolder
from evogymcm.algos.runs.older import present_settings
from evogymcm.algos.runs.origin import usable_cores
from evogymcm.body import as_body, check_stiffness
from evogymcm.envs.dealing import BodySpec
from evogymcm.sim.world import World
from evogymcm.studio.processes import Job, Tell

PPO = PPOConfig(total_steps=300_000, eval_interval=10_000)  # a minute or two, with a new picture every few seconds


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

    Raises:
        ValueError: A setting is out of range, or the design is not valid.
    """

    kind = "train"
    _task: str | os.PathLike[str] | World | None = None

    def __init__(
        self,
        folder: str | os.PathLike[str],
        body: BodySpec,
        stiffness: Any = None,
        task: str | os.PathLike[str] | World = "Walker-v0",
        material: str = "invariant",
        ppo: PPOConfig | None = None,
    ) -> None:
        self._task = task
        field = None if stiffness is None else (check_stiffness(stiffness, as_body(body)).tolist(),)
        config = TrainConfig(
            self._own(folder, task),
            (as_body(body),),  # type: ignore[arg-type]
            material,  # type: ignore[arg-type]
            field,
            ppo=PPO if ppo is None else ppo,
        )
        super().__init__(folder, config)

    @classmethod
    def read_config(cls, saved: Mapping[str, Any]) -> TrainConfig:
        """Returns the settings of a training run."""
        saved = present_settings(saved)
        return TrainConfig(**{**saved, "ppo": PPOConfig(**saved["ppo"])})

    def check(self) -> None:
        """Raises a ValueError where the task is unknown, or the design does not fit into its world."""
        from evogymcm.envs.core import TaskEngine
        from evogymcm.envs.tasks import as_task
        from evogymcm.envs.terrain import walking_task

        bodies, fields = self.config.designs()
        task = self.config.task if self._task is None else self._task
        known = walking_task(task) if isinstance(task, World) else as_task(task)
        TaskEngine(known, bodies, material=self.config.material, stiffness=fields, num_threads=1)

    def work(self, run: RunFolder, should_stop: Callable[[], bool], tell: Tell) -> bool:
        """Trains to the end, or until it should stop."""
        from evogymcm.algos.learning.memory import keep_freed_memory
        from evogymcm.algos.learning.training import train

        keep_freed_memory()
        threads = max(1, usable_cores() - 1)  # one is left for those who look on
        return train(self.config, run=run, should_stop=should_stop, num_threads=threads).finished

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
