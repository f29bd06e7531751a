"""Experiments B and C of the EvoGymCM paper: co-design with and without material, at equal simulated env-steps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from _comparison import mean_interval
from _suite import PAPER
from _text import aligned

from evogymcm.algos import PPOConfig, RunFolder
from evogymcm.algos.codesign import CodesignConfig, SearchConfig, codesign
from evogymcm.algos.codesign_cost import cost_of

EXPERIMENTS: Mapping[str, tuple[str, str]] = {"B": ("fixed", "reactive"), "C": ("prescribed", "invariant")}
PUBLISHED_BODIES = 100  # trained in all by published runs of EvoGym's genetic algorithm, whose best returns these are
PUBLISHED: Mapping[str, float] = {
    "Walker-v0": 10.55,
    "BridgeWalker-v0": 3.87,
    "DownStepper-v0": 4.90,
    "CaveCrawler-v0": 4.41,
    "AreaMaximizer-v0": 2.52,
    "AreaMinimizer-v0": 0.81,
}
COLOURS: Mapping[str, str] = {
    "fixed": "#0072b2",
    "prescribed": "#0072b2",
    "reactive": "#d55e00",
    "invariant": "#009e73",
}


def _body_budget(env_steps: int, **changes: Any) -> PPOConfig:
    """Returns the inner loop of one body."""
    settings = {"num_worlds": 16, "minibatch": 128, "eval_interval": 10_000, "sharing": "independent"}
    return PPOConfig(total_steps=env_steps, **settings | changes)


@dataclass(frozen=True)
class CodesignSuite:
    """What to run: every task in both arms of an experiment, with every seed."""

    experiment: str
    tasks: tuple[str, ...]
    arms: tuple[str, ...]
    seeds: tuple[int, ...]
    base: CodesignConfig = field(default_factory=CodesignConfig)

    def __post_init__(self) -> None:
        if self.experiment not in EXPERIMENTS:
            raise ValueError(f"experiment: got {self.experiment!r}, allowed are {sorted(EXPERIMENTS)}")
        allowed_arms = EXPERIMENTS[self.experiment]
        for name, given, allowed in (("task", self.tasks, tuple(PAPER)), ("arm", self.arms, allowed_arms)):
            unknown = [item for item in given if item not in allowed]
            if unknown:
                raise ValueError(f"{name}: got {unknown}, allowed are {sorted(allowed)}")
        if not (self.tasks and self.arms and self.seeds):
            raise ValueError("tasks, arms and seeds must not be empty")

    @property
    def steps_per_run(self) -> int:
        """The most env-steps of all kinds that a run takes, but for what it goes beyond a limit."""
        limit = self.base.max_env_steps or np.inf
        return int(min(limit, max(cost_of(job.config).total for job in self.jobs())))

    def jobs(self) -> list["CodesignJob"]:
        """Returns all runs, seed by seed, so that an early stop leaves whole comparisons."""
        return [
            CodesignJob(self.experiment, replace(self.base, task=task, arm=arm, seed=seed))
            for seed in self.seeds
            for task in self.tasks
            for arm in self.arms
        ]


@dataclass(frozen=True)
class CodesignJob:
    """One co-design run."""

    experiment: str
    config: CodesignConfig

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return f"{self.config.task}-{self.config.arm}-seed{self.config.seed}"

    def run(
        self, folder: Path, resume: bool, tell: Callable[[int, float | None], None], should_stop: Callable[[], bool]
    ) -> dict[str, Any]:
        """Searches in `folder / name` and returns all numbers of the run."""
        run = RunFolder(folder / self.name, asdict(self.config), resume=resume)
        result = codesign(
            self.config,
            run=run,
            progress=lambda state: tell(state.env_steps, state.best),
            should_stop=should_stop,
        )
        record: dict[str, Any] = {
            "experiment": self.experiment,
            "task": self.config.task,
            "arm": self.config.arm,
            "seed": self.config.seed,
            "finished": result.finished,
            "env_steps": result.env_steps,
            "bodies": len({row["index"] for row in result.rows}),
            "best": None if result.best is None else result.best.record(),
            "best_return": max((row["return"] for row in result.rows), default=None),
            "curve": curve(result.rows),
        }
        run.write_json("result.json", record)
        return record


def curve(rows: Sequence[Mapping[str, Any]]) -> list[list[float]]:
    """Returns (env-steps, best fitness so far), one point for each phase that ended."""
    points: dict[int, float] = {}
    for row in rows:
        points[row["env_steps"]] = row["best"]
    return [[steps, best] for steps, best in sorted(points.items())]


def _suite(
    experiment: str,
    tasks: tuple[str, ...],
    seeds: tuple[int, ...],
    base: CodesignConfig,
    arms: tuple[str, ...] | None = None,
) -> CodesignSuite:
    return CodesignSuite(experiment, tasks, arms or EXPERIMENTS[experiment], seeds, base)


_SMALL = CodesignConfig(
    population=6, budget=1000, max_env_steps=600_000, finetune_steps=4_096, ppo=_body_budget(25_000)
)
_SHORTCUTS = replace(  # policy inheritance and successive halving: lineages learn on, the worse half is dropped early
    _SMALL,
    population=8,
    budget=32,
    max_env_steps=900_000,
    inherit=True,
    rungs=(0.3,),
    keep=(0.5,),
    ppo=_body_budget(50_000),
)
_MEDIUM = replace(
    _SMALL, population=12, max_env_steps=10_000_000, finetune_steps=10_000, ppo=_body_budget(200_000, num_worlds=32)
)
_PAPER = replace(
    _SMALL,
    population=25,
    budget=100,
    max_env_steps=None,
    finetune_steps=10_000,
    ppo=_body_budget(1_000_000, num_worlds=64, minibatch=512),
)
_QUICK = replace(_SMALL, max_env_steps=150_000, ppo=_body_budget(10_000))
_HUNDRED = replace(_SMALL, budget=PUBLISHED_BODIES, max_env_steps=None, inherit=True)
_HUNDRED_REACTIVE = replace(  # all learn for 80,000 env-steps, then the best fifth for 160,000 more
    _HUNDRED,
    population=12,
    inherit_std=0.6,
    rungs=(1 / 3,),
    keep=(0.2,),
    ppo=_body_budget(240_000, num_worlds=32, eval_interval=20_000),
)
_HUNDRED_INVARIANT = replace(  # fewer env-steps of training; survivors are searched and trained on
    _HUNDRED,
    population=20,
    rungs=(0.125, 0.3),
    keep=(0.4, 0.3),
    finetune_steps=20_000,
    ppo=_body_budget(160_000, num_worlds=32),
)
_HUNDRED_EXPLORING = replace(  # wide exploration at first, and more than their parent's in children
    _HUNDRED,
    population=12,
    inherit_std=1.0,
    rungs=(0.25,),
    keep=(1 / 3,),
    search=SearchConfig(rounds=4, candidates=4),
    finetune_steps=10_000,
    ppo=_body_budget(160_000, num_worlds=32, initial_std=2.0),
)
_HUNDRED_LONG = replace(  # the same with more than twice the training
    _HUNDRED_EXPLORING, ppo=_body_budget(400_000, num_worlds=32, initial_std=2.0, eval_interval=20_000)
)
_HUNDRED_PRESCRIBED = replace(  # no search: all env-steps train, and few bodies are dropped early
    _HUNDRED_EXPLORING,
    keep=(2 / 3,),
    ppo=_body_budget(240_000, num_worlds=32, initial_std=2.0, eval_interval=30_000),
)

PRESETS: Mapping[str, CodesignSuite] = {
    "reactive-quick": _suite("B", ("AreaMaximizer-v0",), (0,), _QUICK),
    "reactive-small": _suite("B", ("AreaMaximizer-v0", "DownStepper-v0"), (0, 1, 2), _SMALL),
    "reactive-shortcuts": _suite("B", ("AreaMaximizer-v0", "DownStepper-v0"), (0, 1, 2), _SHORTCUTS),
    "reactive-medium": _suite("B", ("AreaMaximizer-v0", "DownStepper-v0"), (0, 1, 2), _MEDIUM),
    "reactive-paper": _suite("B", tuple(PAPER), (0, 1, 2), _PAPER),
    "hundred-bodies-reactive": _suite("B", tuple(PAPER), (0,), _HUNDRED_REACTIVE, ("reactive",)),
    "invariant-quick": _suite("C", ("BridgeWalker-v0",), (0,), _QUICK),
    "invariant-small": _suite("C", ("BridgeWalker-v0", "Walker-v0"), (0, 1, 2), _SMALL),
    "invariant-shortcuts": _suite("C", ("BridgeWalker-v0", "Walker-v0"), (0, 1, 2), _SHORTCUTS),
    "invariant-medium": _suite("C", ("BridgeWalker-v0", "Walker-v0"), (0, 1, 2), _MEDIUM),
    "invariant-paper": _suite("C", tuple(PAPER), (0, 1, 2), _PAPER),
    "hundred-bodies-invariant": _suite("C", tuple(PAPER), (0,), _HUNDRED_INVARIANT, ("invariant",)),
    "hundred-bodies-exploring-invariant": _suite("C", tuple(PAPER), (0,), _HUNDRED_EXPLORING, ("invariant",)),
    "hundred-bodies-long-invariant": _suite("C", tuple(PAPER), (0,), _HUNDRED_LONG, ("invariant",)),
    "hundred-bodies-long-prescribed": _suite("C", tuple(PAPER), (0,), _HUNDRED_PRESCRIBED, ("prescribed",)),
}


def best_at(points: Sequence[Sequence[float]], steps: Sequence[float] | np.ndarray) -> np.ndarray:
    """Returns the best fitness that a run had at each number of env-steps, NaN before its first."""
    at, best = np.array(points).T
    place = np.searchsorted(at, steps, side="right") - 1
    return np.where(place >= 0, best[place.clip(0)], np.nan)


def summarise(runs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Returns one row per task and arm: best fitness over the seeds, where the shortest run of the task ended.

    A phase's result is there at its end only, so that a cut shortly before the end of a generation takes all of it from
    a run. Hence `ends`, the best of whole runs, which end within a phase of each other.
    """
    rows = []
    for task in PAPER:
        of_task = [run for run in runs if run["task"] == task and run["curve"]]
        end = min((run["curve"][-1][0] for run in of_task), default=0)
        for arm in dict.fromkeys(run["arm"] for run in of_task):
            group = [run for run in of_task if run["arm"] == arm]
            scores = [float(best_at(run["curve"], [end])[0]) for run in group]
            returns = [run["best_return"] for run in group if run.get("best_return") is not None]
            rows.append(
                {
                    "task": task,
                    "arm": arm,
                    "seeds": len(group),
                    "env_steps": end,
                    "bodies": float(np.mean([run["bodies"] for run in group])),
                    "scores": scores,
                    "mean": float(np.mean(scores)),
                    "std": float(np.std(scores, ddof=1)) if len(scores) > 1 else None,
                    "ends": [float(run["curve"][-1][1]) for run in group],
                    "end_steps": float(np.mean([run["curve"][-1][0] for run in group])),
                    "returns": returns,
                }
            )
    return rows


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns the summary as text; beside published returns where as many bodies were trained."""
    head = ["task", "arm", "seeds", "env-steps", "bodies trained", "best score", "of each seed"]
    head += ["of whole runs", "to env-steps"]
    compared = [row["bodies"] == PUBLISHED_BODIES and bool(row.get("returns")) for row in rows]
    if any(compared):
        head += ["best return", "published"]
    lines = [head]
    for row, is_compared in zip(rows, compared, strict=True):
        spread = "" if row["std"] is None else f" ({row['std']:.2f})"
        each = " ".join(f"{score:.2f}" for score in row["scores"])
        cells = [row["task"], row["arm"], str(row["seeds"]), f"{row['env_steps']:,.0f}", f"{row['bodies']:.0f}"]
        cells += [f"{row['mean']:.2f}{spread}", each]
        cells += [" ".join(f"{score:.2f}" for score in row["ends"]), f"{row['end_steps']:,.0f}"]
        if is_compared:
            cells += [f"{np.mean(row['returns']):.2f}", f"{PUBLISHED[row['task']]:.2f}"]
        lines.append(cells + [""] * (len(head) - len(cells)))
    return aligned(lines)


def _panels(count: int) -> tuple[int, int]:
    """Returns columns and rows of a figure with so many panels, at most three side by side."""
    columns = min(count, 3)
    return columns, -(-count // columns)


def plot(runs: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draws the best score against env-steps of all kinds: mean and its interval over seeds, and single seeds."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    runs = [run for run in runs if run["curve"]]
    tasks = [task for task in PAPER if any(run["task"] == task for run in runs)]
    if not tasks:
        return  # stopped before any run had a score
    columns, n_rows = _panels(len(tasks))
    size = (5 * columns, 3.6 * n_rows)
    figure, axes = plt.subplots(n_rows, columns, figsize=size, squeeze=False, layout="constrained")
    for axis, task in zip(axes.flat, tasks, strict=False):
        of_task = [run for run in runs if run["task"] == task]
        end = min(run["curve"][-1][0] for run in of_task)
        grid = np.linspace(0, end, 200)
        for arm in dict.fromkeys(run["arm"] for run in of_task):
            lines = np.stack([best_at(run["curve"], grid) for run in of_task if run["arm"] == arm])
            known = np.isfinite(lines).all(0)
            style = {"color": COLOURS[arm], "drawstyle": "steps-post"}
            axis.plot(grid, lines.T, lw=0.6, alpha=0.5, **style)
            axis.plot(grid[known], lines[:, known].mean(0), lw=2, label=arm, **style)
            if len(lines) > 1:
                ends = mean_interval(lines[:, known])
                axis.fill_between(grid[known], *ends, color=COLOURS[arm], alpha=0.12, step="post")
        axis.set(title=task, xlabel="simulated env-steps, of all kinds", ylabel="best score so far")
        axis.ticklabel_format(axis="x", style="sci", scilimits=(0, 0))
        seeds = f"mean of {len(lines)} seeds, 95 % interval" if len(lines) > 1 else "one seed"
        axis.legend(fontsize="small", title=seeds, title_fontsize="small")
    for axis in axes.flat[len(tasks) :]:
        axis.set_axis_off()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def draw_designs(runs: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draws the best design of every run, voxels by type and, where it is searched, their stiffness."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.patches import Rectangle

    from evogymcm import Body
    from evogymcm.envs import _palette as palette

    shown = sorted((run for run in runs if run["best"]), key=lambda run: (run["task"], run["arm"], run["seed"]))
    if not shown:
        return
    seeds = len({run["seed"] for run in shown})
    columns, n_rows = (seeds, -(-len(shown) // seeds)) if seeds > 1 else _panels(len(shown))
    size = (2.1 * columns, 2.4 * n_rows)
    figure, axes = plt.subplots(n_rows, columns, figsize=size, squeeze=False, layout="constrained")
    for axis, run in zip(axes.flat, shown, strict=False):
        grid = Body(run["best"]["body"], run["best"]["connections"]).grid
        stiffness = run["best"]["stiffness"]
        for row, column in np.argwhere(grid):
            colour = np.array(palette.type_color(int(grid[row, column]))) / 255
            axis.add_patch(Rectangle((column, -row), 1, 1, facecolor=colour, edgecolor="white", lw=0.6))
            if stiffness is not None:
                ink = "white" if colour.mean() < 0.5 else "black"
                label = f"{stiffness[row][column]:.1f}"
                axis.text(column + 0.5, 0.5 - row, label, color=ink, ha="center", va="center", size=7)
        axis.set(xlim=(-0.1, grid.shape[1] + 0.1), ylim=(0.9 - grid.shape[0], 1.1), aspect="equal")
        axis.set_title(f"{run['task']}\n{run['arm']}, seed {run['seed']}: {run['best']['fitness']:.2f}", size=6)
        axis.set_axis_off()
    for axis in axes.flat[len(shown) :]:
        axis.set_axis_off()
    figure.savefig(path, dpi=150)
    plt.close(figure)
