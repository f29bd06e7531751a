"""Experiment A of the EvoGymCM paper: tasks, arms, budgets, and one job = one training run."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from _signals import analyse_run

from evogymcm import robots
from evogymcm.algos import EnvFactory, PPOConfig, Progress, RunFolder, train

ARMS: Mapping[str, str] = {"control-only": "invariant", "co-optimisation": "reactive"}  # -> material setting


@dataclass(frozen=True)
class PaperRow:
    """A row of the paper's Table I: robot, and mean and standard deviation of the score over three seeds."""

    robot: str
    scores: Mapping[str, tuple[float, float]]


def _paper(robot: str, control: tuple[float, float], both: tuple[float, float]) -> PaperRow:
    return PaperRow(robot, {"control-only": control, "co-optimisation": both})


PAPER: Mapping[str, PaperRow] = {
    "Walker-v0": _paper("Walk_Bot", (9.46, 0.03), (9.55, 0.01)),
    "BridgeWalker-v0": _paper("Bridge_Bot", (2.10, 0.23), (2.97, 0.24)),
    "DownStepper-v0": _paper("Down_Bot", (3.25, 0.27), (3.92, 0.16)),
    "CaveCrawler-v0": _paper("Cave_Bot", (2.02, 0.01), (2.03, 0.01)),
    "AreaMaximizer-v0": _paper("Amax_Bot", (0.62, 0.07), (0.74, 0.14)),
    "AreaMinimizer-v0": _paper("Amin_Bot", (0.61, 0.04), (0.69, 0.04)),
}


@dataclass(frozen=True)
class Suite:
    """What to run: every task in every arm with every seed."""

    tasks: tuple[str, ...]
    arms: tuple[str, ...]
    seeds: tuple[int, ...]
    ppo: PPOConfig

    def __post_init__(self) -> None:
        for name, given, allowed in (("task", self.tasks, PAPER), ("arm", self.arms, ARMS)):
            unknown = [item for item in given if item not in allowed]
            if unknown:
                raise ValueError(f"{name}: got {unknown}, allowed are {sorted(allowed)}")
        if not (self.tasks and self.arms and self.seeds):
            raise ValueError("tasks, arms and seeds must not be empty")

    @property
    def steps_per_run(self) -> int:
        """Env-steps of each run, in whole rollouts."""
        return -(-self.ppo.total_steps // self.ppo.frames_per_update) * self.ppo.frames_per_update

    def jobs(self) -> list["Job"]:
        """Returns all runs, seed by seed, so that an early stop leaves whole comparisons."""
        return [
            Job(task, arm, replace(self.ppo, seed=seed))
            for seed in self.seeds
            for task in self.tasks
            for arm in self.arms
        ]


PRESETS: Mapping[str, Suite] = {
    "quick": Suite(("Walker-v0",), tuple(ARMS), (0,), PPOConfig(total_steps=500_000)),
    "walker": Suite(("Walker-v0",), ("co-optimisation",), (0, 1, 2), PPOConfig(total_steps=600_000)),
    "standard": Suite(tuple(PAPER), tuple(ARMS), (0,), PPOConfig(total_steps=500_000)),
    "table": Suite(tuple(PAPER), tuple(ARMS), (0, 1, 2), PPOConfig(total_steps=600_000, eval_interval=20_000)),
    "paper": Suite(tuple(PAPER), tuple(ARMS), (0, 1, 2), PPOConfig(total_steps=1_000_000)),
    "exploring": Suite(  # nearly all actions are bounds at first: PPO finds a posture that it passes by otherwise
        ("AreaMinimizer-v0",),
        tuple(ARMS),
        (0, 1, 2),
        PPOConfig(total_steps=600_000, eval_interval=20_000, initial_std=4.0),
    ),
}


@dataclass(frozen=True)
class Job:
    """One training run."""

    task: str
    arm: str
    ppo: PPOConfig

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return f"{self.task}-{self.arm}-seed{self.ppo.seed}"

    def make_env(self) -> EnvFactory:
        """Returns the factory of the run's environments."""
        from evogymcm.envs import SoftRobotEnv

        robot = robots[PAPER[self.task].robot]
        return functools.partial(SoftRobotEnv, self.task, bodies=robot, material=ARMS[self.arm], num_threads=1)

    def run(
        self, folder: Path, resume: bool, tell: Callable[[int, float | None], None], should_stop: Callable[[], bool]
    ) -> dict[str, Any]:
        """Trains in `folder / name` and returns all numbers of the run.

        A finished run with stiffness control also gets signals.json and signals.png, see `_signals.py`.

        Args:
            folder: of the suite.
            resume: go on with what is there.
            tell: called with the env-steps done and the latest score, None where there is no new one.
            should_stop: asked after every update.
        """

        def progress(state: Progress) -> None:
            tell(state.env_steps, state.row.get("score"))

        run = RunFolder(folder / self.name, asdict(self), resume=resume)
        result = train(self.make_env(), self.ppo, run=run, progress=progress, should_stop=should_stop)
        record: dict[str, Any] = {
            "task": self.task,
            "arm": self.arm,
            "seed": self.ppo.seed,
            "robot": PAPER[self.task].robot,
            "finished": result.finished,
            "env_steps": result.env_steps,
            "train_seconds": result.seconds,
            "env_steps_per_s": result.env_steps / max(result.seconds, 1e-9),
            "untrained": {key: result.rows[0][key] for key in ("score", "return")},
            "best_score": result.best_score,
            "final": None if result.final is None else result.final.summary(),
            "ceiling": None if result.final is None else float(result.final.ceiling[0]),
            "curve": [[row["env_steps"], row["seconds"], row["score"]] for row in result.rows if "score" in row],
        }
        run.write_json("result.json", record)
        if result.finished and ARMS[self.arm] == "reactive":
            record["signals"] = analyse_run(run.path, self.task, robots[PAPER[self.task].robot]).summary()
            run.write_json("result.json", record)
        return record
