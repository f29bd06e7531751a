"""Experiments B and C: co-design of body and control, with material and without, at equal simulated env-steps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.experiments import figures, observations
from benchmarks.experiments.experiment import Comparison, Record, Tell
from benchmarks.experiments.paper import PAPER, PUBLISHED, PUBLISHED_BODIES
from benchmarks.experiments.signals import analyse_run
from benchmarks.experiments.tables import joined, table
from evogymcm.algos.analysis import resample, summarise
from evogymcm.algos.codesign import BodyPPOConfig, CodesignConfig, SearchConfig, codesign, cost_of
from evogymcm.algos.runs import RunFolder, RunRecord

ARMS: Mapping[str, Mapping[str, Any]] = {  # -> what differs from the settings of a run with a search
    "fixed": {"search": None},
    "reactive": {"material": "reactive", "search": None},
    "invariant": {},
}
_BASE = CodesignConfig(
    material="invariant",
    initial="fresh",  # as in the paper
    search=SearchConfig(),
    population=6,
    budget=1000,
    max_env_steps=600_000,
    finetune_steps=4_096,
    piece=None,  # runs go side by side, each on one core, where one batch is fastest
    ppo=BodyPPOConfig(total_steps=25_000),
)


@dataclass(frozen=True)
class CodesignJob:
    """One co-design run."""

    arm: str
    config: CodesignConfig

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return f"{self.config.task}-{self.arm}-seed{self.config.seed}"

    def run(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Searches in `folder / name` and returns all numbers of the run, and those of a gait that sets stiffness."""
        run = RunFolder(folder / self.name, {"label": self.arm, **asdict(self.config)}, resume=resume)
        told = {"progress": lambda state: tell(state.env_steps, state.best), "should_stop": should_stop}
        result = codesign(self.config, run=run, workers=1, **told)
        record = RunRecord.read(run.path).as_dict()
        record["best_return"] = max((row["return"] for row in result.rows), default=None)
        if result.finished and self.config.material == "reactive":
            record["signals"] = analyse_run(run.path).summary()
        return record


@dataclass(frozen=True)
class EvolvedRobots(Comparison):
    """Evolution of bodies: in arm "fixed" with stiffness 1, in "reactive" with policies that set stiffness, in
    "invariant" with stiffness fields of designs, which are searched, and survivors' fine-tuning.

    Experiment B compares the first two, experiment C the first and the third. Arms have the same budget of simulated
    env-steps, evaluations included, and are compared where the shortest run of the task ends. A phase's result is there
    at its end only, so that a cut shortly before the end of a generation takes all of it from a run; hence the column
    of whole runs, which end within a phase of each other.

    Attributes:
        codesign: settings of each run with a search of stiffness; task, seed and arm come from the fields above.
    """  # noqa: D205

    codesign: CodesignConfig = _BASE

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.codesign.search:
            raise ValueError("codesign.search: got None, here arms decide whether there is one")
        for name, ours in (("task", "tasks"), ("seed", "seeds")):
            given = getattr(self.codesign, name)
            if given != getattr(CodesignConfig(), name):
                raise ValueError(f"codesign.{name}: got {given!r}, here it comes from {ours}")

    @property
    def allowed_arms(self) -> tuple[str, ...]:
        """All arms that there are."""
        return tuple(ARMS)

    @property
    def steps_per_run(self) -> int:
        """The most env-steps of all kinds that a run takes, but for what it goes beyond a limit."""
        limit = self.codesign.max_env_steps or np.inf
        return int(min(limit, max(cost_of(job.config).total for job in self.jobs())))

    def job(self, task: str, arm: str, seed: int) -> CodesignJob:
        """Returns one run."""
        return CodesignJob(arm, replace(self.codesign, task=task, seed=seed, **ARMS[arm]))

    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns one row a task and arm: best fitness over the seeds, where the shortest run of the task ended."""
        rows = []
        runs = [run for run in runs if run["curve"]]
        for task, arm, group in self.groups(runs):
            end = min(run["curve"][-1][0] for run in runs if run["task"] == task)
            rows.append(
                {
                    "task": task,
                    "arm": arm,
                    "env_steps": end,
                    "bodies": float(np.mean([run["n_designs"] for run in group])),
                    "scores": [float(resample(run["curve"], [end], is_stepwise=True)[0]) for run in group],
                    "ends": [float(run["curve"][-1][1]) for run in group],
                    "end_steps": float(np.mean([run["curve"][-1][0] for run in group])),
                    "returns": [run["best_return"] for run in group if run.get("best_return") is not None],
                    **observations.observed(group),
                }
            )
        return rows

    def table(self, rows: Sequence[Record]) -> str:
        """Returns the summary, beside published returns where as many bodies were trained, and what designs show."""
        head = ["task", "arm", "seeds", "env-steps", "bodies trained", "best score", "of each seed"]
        head += ["of whole runs", "to env-steps"]
        compared = [row["bodies"] == PUBLISHED_BODIES and bool(row["returns"]) for row in rows]
        lines = [head + ["best return", "published"] * any(compared)]
        for row, is_compared in zip(rows, compared, strict=True):
            cells = [
                row["task"],
                row["arm"],
                str(len(row["scores"])),
                f"{row['env_steps']:,.0f}",
                f"{row['bodies']:.0f}",
            ]
            cells += [str(summarise(row["scores"])), joined(row["scores"])]
            cells += [joined(row["ends"]), f"{row['end_steps']:,.0f}"]
            if is_compared:
                cells += [f"{np.mean(row['returns']):.2f}", f"{PUBLISHED[row['task']]:.2f}"]
            lines.append(cells + [""] * (len(lines[0]) - len(cells)))
        return "\n\n".join([table(lines), *observations.tables(rows)])

    def plot(self, runs: Sequence[Record], path: Path) -> None:
        """Draws the best score against env-steps, PATH-designs the best designs, PATH-stiffness their mean fields."""
        figures.best_curves(runs, self.tasks, self.arms, path)
        figures.designs(runs, path.with_name(f"{path.stem}-designs{path.suffix}"))
        observations.plot(self.groups(runs), path)


def _sizes(arms: tuple[str, ...], quick: str, small: tuple[str, ...]) -> Mapping[str, EvolvedRobots]:
    """Returns the three sizes with a task of the first, and tasks of the second."""
    shorter = replace(_BASE, max_env_steps=150_000, ppo=BodyPPOConfig(total_steps=10_000))
    paper = replace(
        _BASE,
        population=25,
        budget=PUBLISHED_BODIES,
        max_env_steps=None,
        finetune_steps=10_000,
        ppo=BodyPPOConfig(total_steps=1_000_000, num_worlds=64, minibatch=512),
    )
    return {
        "quick": EvolvedRobots((quick,), arms, (0,), shorter),
        "small": EvolvedRobots(small, arms, (0, 1, 2), _BASE),
        "paper": EvolvedRobots(tuple(PAPER), arms, (0, 1, 2), paper),
    }


SIZES_B = _sizes(("fixed", "reactive"), "AreaMaximizer-v0", ("AreaMaximizer-v0", "DownStepper-v0"))
SIZES_C = _sizes(("fixed", "invariant"), "BridgeWalker-v0", ("BridgeWalker-v0", "Walker-v0"))
