"""What is shown of results: table.md of a folder, and the tables and figures of docs/results.md and README.md."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import mean
from typing import Any

from benchmarks.experiments.fixed_robots import FixedRobots
from benchmarks.experiments.options import parse_command
from benchmarks.experiments.paper import FIXED_ARMS
from benchmarks.experiments.tables import table
from evogymcm.algos.learning.config import FRESH

ROOT = Path(__file__).resolve().parents[2]
RESULTS, DOCS, README = ROOT / "benchmarks" / "results", ROOT / "docs" / "results.md", ROOT / "README.md"


def page(results: Mapping[str, Any]) -> str:
    """Returns table.md of what results.json holds: how to run it, the tables, and where and when it was run."""
    experiment = parse_command(results["command"]).experiment
    tables = experiment.table(experiment.summarise(results["runs"]))
    where = f"{results['machine']['cpu']}, {results['machine']['cores']} cores, {results['processes']} processes"
    origins = [run["origin"] for run in results["runs"] if "origin" in run] or [results]
    commits = " and ".join(sorted({str(origin["commit"])[:7] for origin in origins}))
    state = "" if results["finished"] else " Not finished."
    origin = f"{where}: {results['wall_seconds'] / 60:.0f} minutes. Commit {commits}.{state}"
    return f"```sh\n{results['command']}\n```\n\n{tables}\n\n{origin}\n"


def _shown(file: Path, tables: Mapping[str, str]) -> str:
    """Returns the text of a page with these tables, by name, between its marks; those without marks are left out."""
    text = file.read_text(encoding="utf-8")
    for name, content in tables.items():
        begin, end = f"<!-- {name}: written by run_suite.py write-docs -->\n", f"<!-- end of {name} -->\n"
        if begin in text:
            before, rest = text.split(begin)
            text = f"{before}{begin}\n{content}\n{end}{rest.split(end)[1]}"
    return text


def pages() -> dict[Path, str]:
    """Returns every file with tables of committed results, as it should be."""
    found = {
        path.parent: json.loads(path.read_text(encoding="utf-8")) for path in sorted(RESULTS.glob("*/results.json"))
    }
    tables = {folder.name: page(results) for folder, results in found.items()}
    files = {folder / "table.md": tables[folder.name] for folder in found}
    return files | {DOCS: _shown(DOCS, tables), README: _shown(README, {"A in short": _short(found.values())})}


def _short(found: Iterable[Mapping[str, Any]]) -> str:
    """Returns the means of all results of experiment A in a table: best in training, last policy, the paper's."""
    lines: list[Sequence[str]] = [("", *(f"{arm}: {kind}" for arm in FIXED_ARMS for kind in ("best", "last", "paper")))]
    for results in found:
        experiment = parse_command(results["command"]).experiment
        if type(experiment) is FixedRobots and experiment.initial == FRESH:  # as in the paper
            rows = {(row["task"], row["arm"]): row for row in experiment.summarise(results["runs"])}
            for task in experiment.tasks:
                line = [f"{task}, `--tuned`" if experiment.tuned else task]
                for row in (rows[task, arm] for arm in FIXED_ARMS):
                    scores = (mean(row["best"]), mean(row["final"]), row["paper_score"])
                    line += [f"{score:.2f}" for score in scores]
                lines.append(line)
    return f"{table(lines)}\n"


def write_docs(figures: bool = True) -> None:
    """Writes the tables of all committed results where they are shown, and the figures of docs/results.md."""
    for file, text in pages().items():
        file.write_text(text, encoding="utf-8")
    for path in sorted(RESULTS.glob("*/results.json")) if figures else ():
        results = json.loads(path.read_text(encoding="utf-8"))
        image = DOCS.parent / "img" / f"{path.parent.name}.png"
        if f"(img/{image.name})" in DOCS.read_text(encoding="utf-8"):
            parse_command(results["command"]).experiment.plot(results["runs"], image)
