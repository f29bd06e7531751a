"""What a voxel may know of the rest of its body, and the plain network, at equal env-steps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import mean, median

from benchmarks.experiments.experiment import Record
from benchmarks.experiments.fixed_robots import FixedRobots
from benchmarks.experiments.tables import joined, table
from benchmarks.experiments.training import TrainingJob, best_score, mean_of_curve
from evogymcm.algos.analysis import summarise
from evogymcm.algos.learning import PPOConfig
from evogymcm.algos.learning.config import Material

ARMS: Mapping[str, Mapping[str, str]] = {  # -> settings of PPOConfig
    "none": {"context": "none"},
    "body": {"context": "body"},
    "message": {"context": "message"},
    "attention": {"context": "attention"},
    "mlp": {"network": "mlp"},
}


@dataclass(frozen=True)
class Contexts(FixedRobots):
    """Training of the paper's robots with each context of the per-voxel network, and with the plain one ("mlp").

    The mean of curve is the area under the learning curve over its length. The rate is that of collecting and learning
    without evaluations, with as many processes at work as results.json says.

    Attributes:
        material: "reactive" (policies set stiffness) or "invariant".
    """

    tasks: tuple[str, ...] = ("Walker-v0", "DownStepper-v0")
    arms: tuple[str, ...] = tuple(ARMS)
    seeds: tuple[int, ...] = (0, 1, 2)
    material: Material = "reactive"
    ppo: PPOConfig = field(default_factory=PPOConfig)

    @property
    def allowed_arms(self) -> tuple[str, ...]:
        """All arms that there are."""
        return tuple(ARMS)

    def job(self, task: str, arm: str, seed: int) -> TrainingJob:
        """Returns one run."""
        return TrainingJob(arm, self.settings(task, self.material, seed, **ARMS[arm]))

    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns one row a task and arm over its finished runs."""
        rows = []
        for task, arm, group in self.groups([run for run in runs if run["finished"]]):
            rates = [run["env_steps_per_s"] for run in group if run["env_steps_per_s"] is not None]
            rows.append(
                {
                    "task": task,
                    "arm": arm,
                    "env_steps": group[0]["env_steps"],
                    "scores": [run["final"]["score"] for run in group],
                    "best_score": mean(map(best_score, group)),
                    "mean_of_curve": mean(mean_of_curve(run["curve"]) for run in group),
                    "env_steps_per_s": median(rates) if rates else None,
                }
            )
        return rows

    def table(self, rows: Sequence[Record]) -> str:
        """Returns the summary."""
        lines = [
            (
                "task",
                "arm",
                "env-steps",
                "final score",
                "of each seed",
                "best in training",
                "mean of curve",
                "env-steps/s",
            )
        ]
        for row in rows:
            speed = "" if row["env_steps_per_s"] is None else f"{row['env_steps_per_s']:,.0f}"
            head = (row["task"], row["arm"], f"{row['env_steps']:,}", str(summarise(row["scores"])))
            best = f"{row['best_score']:.2f}"
            lines.append((*head, joined(row["scores"]), best, f"{row['mean_of_curve']:.2f}", speed))
        return table(lines)


SIZES: Mapping[str, Contexts] = {
    "quick": Contexts(("Walker-v0",), seeds=(0,), ppo=PPOConfig(total_steps=50_000, eval_interval=5_000)),
    "small": Contexts(seeds=(0, 1), ppo=PPOConfig(total_steps=150_000, eval_interval=7_500)),
    "paper": Contexts(ppo=PPOConfig(total_steps=1_000_000)),
}
