"""Measures what it costs, and what it gives, to share one policy among many bodies.

    python benchmarks/sharing.py
    python benchmarks/sharing.py --task DownStepper-v0 --bodies 16 --total-steps 1000000

Two arms of equal env-steps, each in a process of its own. "shared" trains one policy on random bodies at once, scores
it on bodies that it has not seen, and fine-tunes it there, each body for itself. "independent" trains a network for
each of the same bodies, and then, for as long as fine-tuning lasts, one from scratch for each unseen body.

Scores are those of the last policy, deterministic, in fresh worlds, each body by itself. Intervals are bootstrap
intervals (95 %) of the mean over bodies, and differences on the same bodies are paired: they tell how much the draw of
bodies matters. How much the training seed matters, only runs with other seeds can tell.
"""

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from _machine import commit, machine, usable_cores, versions
from _sharing import ARMS, ORDER, Experiment, Scores
from _text import markdown
from run_suite import run_all

from evogymcm._files import write_atomic
from evogymcm.algos import RunFolder

COMPARED = (  # on the same bodies
    ("seen", "shared", "independent"),
    ("unseen", "zero-shot", "untrained"),
    ("unseen", "fine-tuned", "zero-shot"),
    ("unseen", "fine-tuned", "scratch"),
)
_COLOURS: Mapping[str, str] = {
    "untrained": "0.6",
    "shared": "#d55e00",
    "independent": "#0072b2",
    "zero-shot": "#e69f00",
    "fine-tuned": "#d55e00",
    "scratch": "#0072b2",
}
_RESAMPLES = 10_000


def resampled_means(values: Sequence[float] | np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Returns the means of bootstrap samples."""
    array = np.asarray(values, dtype=np.float64)
    return array[rng.integers(len(array), size=(_RESAMPLES, len(array)))].mean(1)


def interval(means: np.ndarray) -> list[float]:
    """Returns the middle 95 % of bootstrap means."""
    return np.quantile(means, (0.025, 0.975)).tolist()


def merge(arms: Sequence[Mapping[str, Any]]) -> Scores:
    """Returns the scores of all arms together."""
    found: Scores = {bodies: {} for bodies in ORDER}
    for arm in arms:
        for bodies, scores in arm["scores"].items():
            found[bodies] |= scores
    return {bodies: {p: found[bodies][p] for p in policies if p in found[bodies]} for bodies, policies in ORDER.items()}


def summarise(arms: Sequence[Mapping[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Returns rows of scores, and of differences: on the same bodies, and between seen and unseen ones."""
    scores, rng = merge(arms), np.random.default_rng(0)
    training = {policy: record for arm in arms for policy, record in arm["training"].items() if record["finished"]}
    rows, differences = [], []
    for bodies, of_bodies in scores.items():
        for policy, values in of_bodies.items():
            known = training.get(policy)
            rows.append(
                {
                    "bodies": bodies,
                    "policy": policy,
                    "count": len(values),
                    "env_steps": known["env_steps"] if known else None,
                    "mean": float(np.mean(values)),
                    "interval": interval(resampled_means(values, rng)),
                    "median": float(np.median(values)),
                    "best_in_training": float(np.mean(known["best_scores"])) if known else None,
                }
            )
    for bodies, one, other in COMPARED:
        if one in scores[bodies] and other in scores[bodies]:
            gain = np.subtract(scores[bodies][one], scores[bodies][other])
            row = {"what": f"{one} - {other}, {bodies}", "mean": float(gain.mean()), "better_on": int((gain > 0).sum())}
            differences.append(row | {"of": len(gain), "interval": interval(resampled_means(gain, rng))})
    if "zero-shot" in scores["unseen"]:
        unseen, seen = scores["unseen"]["zero-shot"], scores["seen"]["shared"]
        row = {"what": "zero-shot, unseen - shared, seen", "mean": float(np.mean(unseen) - np.mean(seen))}
        spread = interval(resampled_means(unseen, rng) - resampled_means(seen, rng))
        differences.append(row | {"better_on": None, "of": None, "interval": spread})
    return {"scores": rows, "differences": differences}


def table(summary: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Returns the summary as Markdown."""

    def span(row: Mapping[str, Any]) -> str:
        return "{:.2f} to {:.2f}".format(*row["interval"])

    lines = [("bodies", "policy", "env-steps", "mean score", "95 % interval", "median", "best in training")]
    for row in summary["scores"]:
        steps = "" if row["env_steps"] is None else f"{row['env_steps']:,}"
        best = "" if row["best_in_training"] is None else f"{row['best_in_training']:.2f}"
        head = (f"{row['count']} {row['bodies']}", row["policy"], steps, f"{row['mean']:.2f}")
        lines.append((*head, span(row), f"{row['median']:.2f}", best))
    gains = [("difference of means", "", "95 % interval", "better on")]
    for row in summary["differences"]:
        better = "" if row["of"] is None else f"{row['better_on']} of {row['of']}"
        gains.append((row["what"], f"{row['mean']:+.2f}", span(row), better))
    return "\n\n".join(markdown(part) for part in (lines, gains) if len(part) > 1)


def plot(arms: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draws each body's scores, sorted, and how training on the unseen bodies went."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(15, 4), layout="constrained")
    for axis, (bodies, scores) in zip(axes, merge(arms).items(), strict=False):
        order = np.argsort(next((scores[p] for p in ("shared", "zero-shot") if p in scores), []))
        for policy, values in scores.items():
            ranked = np.array(values)[order] if len(order) else np.array(values)
            axis.plot(ranked, "o-", color=_COLOURS[policy], ms=4, lw=0.8, label=f"{policy}, {ranked.mean():.2f}")
        axis.set(title=f"{bodies} bodies", xlabel="body, by the shared policy's score", ylabel="score")
    training = {policy: record for arm in arms for policy, record in arm["training"].items()}
    for policy in (p for p in ORDER["unseen"] if p in training):
        axes[2].plot(*zip(*training[policy]["curve"], strict=True), "o-", color=_COLOURS[policy], ms=3, label=policy)
    axes[2].set(title="training on the unseen bodies", xlabel="env-steps of each body", ylabel="mean score")
    for axis in axes:
        if axis.has_data():
            axis.legend(fontsize="small")
    figure.savefig(path, dpi=150)
    plt.close(figure)


@dataclass(frozen=True)
class Options:
    """Command line.

    Attributes:
        experiment: what to measure.
        output: folder of the results; default runs/sharing-TASK.
        processes: arms trained side by side; default both where there are two cores.
        resume: go on with the experiment in the folder.
        overwrite: delete the experiment in the folder first.
    """

    experiment: tyro.conf.OmitArgPrefixes[Experiment] = field(default_factory=Experiment)
    output: Path | None = None
    processes: int | None = None
    resume: bool = False
    overwrite: bool = False


def main(options: Options) -> int:
    """Runs both arms, writes results.json, results.md and scores.png into the folder and prints the tables."""
    experiment = options.experiment
    folder = options.output or Path("runs") / f"sharing-{experiment.task}"
    try:
        run = RunFolder(folder, asdict(experiment), resume=options.resume, overwrite=options.overwrite)
    except (FileExistsError, ValueError) as error:
        print(f"{error} (--resume, --overwrite)", file=sys.stderr)
        return 2
    start = time.perf_counter()
    processes = min(options.processes or usable_cores(), len(ARMS))
    arms = run_all(experiment, folder, processes, options.resume)
    is_complete = len(arms) == len(ARMS) and all(arm["finished"] for arm in arms)
    text = table(summary := summarise(arms))
    results = {
        "experiment": asdict(experiment),
        "finished": is_complete,
        "processes": processes,
        "machine": machine(),
        "versions": versions(),
        "commit": commit(),
        "wall_seconds": time.perf_counter() - start,
        "summary": summary,
        "bodies": {name: [design.body.text for design in group] for name, group in experiment.designs().items()},
        "arms": arms,
    }
    run.write_json("results.json", results)
    given = ", ".join(f"{entry.name} {getattr(experiment, entry.name)}" for entry in fields(experiment))
    where = f"{results['machine']['cpu']}, commit {results['commit']}"
    state = "" if is_complete else " Not finished."
    page = f"# Sharing a policy\n\n{given}. {where}.{state}\n\n{text}\n"
    write_atomic(folder / "results.md", lambda part: part.write_text(page, encoding="utf-8"))
    try:
        plot(arms, folder / "scores.png")
    except ModuleNotFoundError:
        print("No figure: it needs matplotlib (pip install evogymcm[render]).", file=sys.stderr)
    print(text)
    print(f"Results: {folder.resolve()}")
    if not is_complete:
        print("Not finished; go on with --resume.")
    return 0 if is_complete else 1


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
