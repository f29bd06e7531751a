"""Bodies that evolve together with their gaits: experiments B and C in one, with one episode a candidate."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from statistics import mean, median
from typing import Any

from benchmarks.experiments import figures, observations
from benchmarks.experiments.experiment import Comparison, Record, Tell
from benchmarks.experiments.paper import PAPER, PUBLISHED
from benchmarks.experiments.signals import analyse_run
from benchmarks.experiments.tables import joined, table, with_interval
from evogymcm._settings import WORK
from evogymcm.algos.analysis import coverage, difference, improvement, interquartile_mean, normalise, summarise
from evogymcm.algos.codesign import EvolveConfig, evolve
from evogymcm.algos.runs import RunFolder, RunRecord

CONTROL = "fixed"
ARMS: Mapping[str, Mapping[str, Any]] = {  # -> what differs from the defaults
    CONTROL: {},
    "reactive": {"material": "reactive"},
    "invariant": {"evolves_stiffness": True},
    "priced": {"material": "reactive", "work_weight": (0.0, 1e-5)},
}
_FROM_ARMS = ("material", "evolves_stiffness", "task", "seed")


@dataclass(frozen=True)
class EvolveJob:
    """One evolution."""

    arm: str
    config: EvolveConfig

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return f"{self.config.task}-{self.arm}-seed{self.config.seed}"

    def run(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Evolves in `folder / name` and returns all numbers of the run."""
        run = RunFolder(folder / self.name, {"label": self.arm, **asdict(self.config)}, resume=resume)
        told = {"progress": lambda state: tell(state.env_steps, state.best), "should_stop": should_stop}
        result = evolve(self.config, run=run, **told)
        record = RunRecord.read(run.path).as_dict()
        best = accumulate((row["return"] for row in result.rows), max)
        record["returns"] = _rises([[row["env_steps"], value] for row, value in zip(result.rows, best, strict=True)])
        record["curve"] = _rises(record["curve"])
        if result.finished and self.config.material == "reactive":
            record["signals"] = analyse_run(run.path).summary()
        return record | {"played": result.played}


@dataclass(frozen=True)
class EvolvedGaits(Comparison):
    """Evolution of bodies with their gaits: with stiffness 1 ("fixed"), with gaits that set stiffness ("reactive"), and
    with stiffness fields that evolve with the bodies ("invariant").

    In arm "priced" gaits set stiffness and pay for the work that its changes supply: 1 for each 100,000, so that
    designs are selected that need little of it. It is run where it is asked for. All arms have equal env-steps, one
    recipe for all tasks.

    Attributes:
        evolve: settings of each run; task, seed and material come from the fields above.
    """  # noqa: D205

    tasks: tuple[str, ...] = tuple(PAPER)
    arms: tuple[str, ...] = (CONTROL, "reactive", "invariant")
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    evolve: EvolveConfig = field(default_factory=lambda: EvolveConfig(max_env_steps=2_000_000, num_threads=1))

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in _FROM_ARMS:
            given = getattr(self.evolve, name)
            if given != getattr(EvolveConfig(), name):
                raise ValueError(f"evolve.{name}: got {given!r}, here it comes from tasks, arms and seeds")

    @property
    def allowed_arms(self) -> tuple[str, ...]:
        """All arms that there are."""
        return tuple(ARMS)

    @property
    def steps_per_run(self) -> int:
        """Env-steps of a run, but for what its last generation goes beyond, and the last survivors' starts."""
        return self.evolve.max_env_steps

    def job(self, task: str, arm: str, seed: int) -> EvolveJob:
        """Returns one run."""
        return EvolveJob(arm, replace(self.evolve, task=task, seed=seed, **ARMS[arm]))

    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns one row a task and arm over its finished runs."""
        rows = []
        for task, arm, group in self.groups([run for run in runs if run["finished"]]):
            reached = [_first(run["returns"], PUBLISHED[task]) for run in group]
            known = sorted(step for step in reached if step is not None)
            rows.append(
                {
                    "task": task,
                    "arm": arm,
                    "env_steps": mean(run["env_steps"] for run in group),
                    "scores": [run["best"]["fitness"] for run in group],
                    "robust": [run["best"].get("robust_score") for run in group],
                    "returns": [run["best"]["return"] for run in group],
                    "means_of_curve": [mean_of_steps(run["curve"], self.evolve.max_env_steps) for run in group],
                    "reached": len(known),
                    "steps_to_published": median(known) if 2 * len(known) > len(group) else None,
                    "work": {name: [run["best"].get(name) for run in group] for name in WORK},
                    "played": mean(run["played"] for run in group),
                    "seconds": mean(run["seconds"] or 0.0 for run in group),
                    **observations.observed(group),
                }
            )
        return rows

    def table(self, rows: Sequence[Record]) -> str:
        """Returns the scores and returns beside published ones, and what stiffness is worth."""
        parts = [table(_lines(rows)), table(_work_lines(rows))]
        for arm in self.arms:
            pairs = dict(_pairs(rows, arm))
            if arm != CONTROL and pairs:
                parts.append(table(_gain_lines(arm, pairs)))
        counts = [len(row["scores"]) for row in rows]
        return "\n\n".join([*parts, _note(counts), *observations.tables(rows)]) if rows else ""

    def plot(self, runs: Sequence[Record], path: Path) -> None:
        """Draws the best score against env-steps, PATH-designs the best designs, PATH-stiffness their mean fields."""
        figures.best_curves(runs, self.tasks, self.arms, path)
        figures.designs(runs, path.with_name(f"{path.stem}-designs{path.suffix}"))
        observations.plot(self.groups(runs), path)


def _work_lines(rows: Sequence[Record]) -> list[Sequence[str]]:
    """Work of the best designs' episodes, in thousands."""
    names = {"actuation_work": "actuation", "stiffness_work": "stiffness", "net_stiffness_work": "net of stiffness"}
    lines: list[Sequence[str]] = [["work of best designs, thousands", "arm", "seeds", *names.values(), "of each seed"]]
    for row in rows:
        known = {name: [value / 1000 for value in row["work"][name] if value is not None] for name in names}
        if all(known.values()):
            own = known["stiffness_work"]
            cells = [f"{mean(values):,.0f}" for values in known.values()]
            lines.append([row["task"], row["arm"], str(len(own)), *cells, " ".join(f"{value:.0f}" for value in own)])
    return lines


def mean_of_steps(curve: Sequence[Sequence[float]], end: float) -> float:
    """Returns the mean over env-steps up to an end of a value that changes at each point and is 0 before the first."""
    known = [(steps, value) for steps, value in [(0, 0.0), *curve] if steps < end]
    ends = [*(steps for steps, _ in known[1:]), end]
    return sum(value * (until - steps) for (steps, value), until in zip(known, ends, strict=True)) / end


def _rises(curve: Sequence[Sequence[float]]) -> list[Sequence[float]]:
    """Returns the points of a curve that are above the one before, the first, and the last."""
    return [curve[i] for i in range(len(curve)) if i in (0, len(curve) - 1) or curve[i][1] > curve[i - 1][1]]


def _first(curve: Sequence[Sequence[float]], level: float) -> float | None:
    """Returns the env-steps at which a curve first reaches a level."""
    return next((steps for steps, value in curve if value >= level), None)


def _lines(rows: Sequence[Record]) -> list[Sequence[str]]:
    head = ["task", "arm", "seeds", "env-steps", "candidates", "score", "robust score", "return", "of each seed"]
    lines: list[Sequence[str]] = [[*head, "published", "reached", "env-steps to it"]]
    for row in rows:
        robust = [value for value in row["robust"] if value is not None]
        cells = [row["task"], row["arm"], str(len(row["scores"])), f"{row['env_steps']:,.0f}", f"{row['played']:,.0f}"]
        cells += [str(summarise(row["scores"])), str(summarise(robust)) if robust else ""]
        cells += [str(summarise(row["returns"])), joined(row["returns"]), f"{PUBLISHED[row['task']]:.2f}"]
        steps = row["steps_to_published"]
        lines.append([*cells, f"{row['reached']} of {len(row['scores'])}", "-" if steps is None else f"{steps:,.0f}"])
    return lines


def _pairs(rows: Sequence[Record], arm: str) -> Iterator[tuple[str, tuple[Record, Record]]]:
    """Yields each task that has runs of an arm and of the control."""
    found = {(row["task"], row["arm"]): row for row in rows}
    for task, name in found:
        if name == arm and (task, CONTROL) in found:
            yield task, (found[task, CONTROL], found[task, arm])


def _gain_lines(arm: str, pairs: Mapping[str, tuple[Record, Record]]) -> list[Sequence[str]]:
    """An arm minus the control, task by task and over all of them."""
    kinds = {"scores": "score", "robust": "robust score", "means_of_curve": "mean of curve"}
    lines: list[Sequence[str]] = [
        [f"{arm} minus {CONTROL}", *(cell for name in kinds.values() for cell in (name, "P"))]
    ]
    usable = {task: pair for task, pair in pairs.items() if all(None not in row["robust"] for row in pair)}
    for task, (control, treated) in usable.items():
        cells = [task]
        for kind in kinds:
            cells.append(with_interval(*difference(control[kind], treated[kind]), "+.2f"))
            cells.append(f"{improvement({task: control[kind]}, {task: treated[kind]})[0]:.2f}")
        lines.append(cells)
    if not usable:
        return lines
    units = {task: PUBLISHED[task] for task in usable}
    middle, chance = [f"interquartile means, {CONTROL} and {arm}"], ["P, mean over tasks"]
    for kind in kinds:
        arms = [normalise({task: pair[i][kind] for task, pair in usable.items()}, units) for i in range(2)]
        middle += [" and ".join(with_interval(*interquartile_mean(of_arm), ".2f") for of_arm in arms), ""]
        chance += [with_interval(*improvement(*arms), ".2f"), ""]
    return [*lines, middle, chance]


def _note(counts: Sequence[int]) -> str:
    """How the numbers are to be read."""
    note = (
        "Work: supplied in an episode by changes of actuation and of stiffness, and what changes of stiffness supply"
        " less what they take back; of each seed, that of stiffness. Candidates: how many were played, most for one"
        " episode. The best design is the one of the last survivors with the highest robust score, the mean over starts"
        " a hair apart, and last reward. Score: of its episode from the"
        " exact start, without the last reward; return: the sum of all rewards, beside the best of published runs of"
        " EvoGym's genetic algorithm (100 bodies trained), how many runs had a survivor that reaches it, and the median"
        " of env-steps until they had. P: how often a run of"
        f" the arm beats one of {CONTROL}. Interquartile means: scores in units of the published return. Mean of"
        " curve: the best score so far, over all env-steps; it tells runs apart that end at the same ceiling."
    )
    seeds = min(counts)
    if seeds > 1:
        note += (
            f" In brackets: 95 % bootstrap intervals over seeds; with {seeds} an arm and normal scores, that of a"
            f" difference holds the true one in {coverage(seeds):.0%} of cases."
        )
    return note


SIZES: Mapping[str, EvolvedGaits] = {
    "quick": EvolvedGaits(("Walker-v0",), seeds=(0,), evolve=EvolveConfig(max_env_steps=100_000, num_threads=1)),
    "small": EvolvedGaits(),
    "paper": EvolvedGaits(evolve=EvolveConfig(max_env_steps=10_000_000, num_threads=1)),
}
