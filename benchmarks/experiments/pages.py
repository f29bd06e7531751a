"""What is shown of results: table.md of a folder, and the tables and figures of docs/results.md."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.experiments.options import parse_command

__all__ = ["DOCS", "RESULTS", "block", "page", "write_docs"]

ROOT = Path(__file__).resolve().parents[2]
RESULTS, DOCS = ROOT / "benchmarks" / "results", ROOT / "docs"


def page(results: Mapping[str, Any]) -> str:
    """Returns table.md of what results.json holds: how to run it, the tables, and where and when it was run."""
    experiment = parse_command(results["command"]).experiment
    table = experiment.table(experiment.summarise(results["runs"]))
    where = f"{results['machine']['cpu']}, {results['machine']['cores']} cores, {results['processes']} processes"
    state = "" if results["finished"] else " Not finished."
    origin = f"{where}: {results['wall_seconds'] / 60:.0f} minutes. Commit {str(results['commit'])[:7]}.{state}"
    return f"```sh\n{results['command']}\n```\n\n{table}\n\n{origin}\n"


def block(name: str) -> tuple[str, str]:
    """Returns what stands before and after the tables of a folder of results in docs/results.md."""
    return f"<!-- {name}: written by run_suite.py write-docs -->\n", f"<!-- end of {name} -->\n"


def write_docs(figures: bool = True) -> None:
    """Writes table.md of all committed results, and the tables and figures of docs/results.md."""
    path = DOCS / "results.md"
    text = path.read_text(encoding="utf-8")
    for folder in sorted(RESULTS.iterdir()):
        results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        (folder / "table.md").write_text(page(results), encoding="utf-8")
        begin, end = block(folder.name)
        if begin in text:
            before, rest = text.split(begin)
            text = f"{before}{begin}\n{page(results)}\n{end}{rest.split(end)[1]}"
        if figures:
            experiment = parse_command(results["command"]).experiment
            experiment.plot(results["runs"], DOCS / "img" / f"{folder.name}.png")
    path.write_text(text, encoding="utf-8")
