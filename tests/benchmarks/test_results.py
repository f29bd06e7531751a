"""Committed results: what they were made with can be asked for today, and what is shown of them is what they hold."""

import json

import pytest

from benchmarks.experiments.options import command_of, parse_command
from benchmarks.experiments.pages import DOCS, RESULTS, block, page

FOLDERS = sorted(RESULTS.iterdir())
PAGE = (DOCS / "results.md").read_text(encoding="utf-8")


def read(folder, name):
    return json.loads((folder / name).read_text(encoding="utf-8"))


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_what_was_run_can_be_asked_for_today(folder):
    assert {path.name for path in folder.iterdir()} == {"config.json", "results.json", "table.md"}
    config, results = read(folder, "config.json"), read(folder, "results.json")
    command = config.pop("command")
    options = parse_command(command)
    assert command_of(options.name, options.experiment) == command == results["command"]
    assert options.settings() == config == results["suite"]
    names = [job.name for job in options.experiment.jobs()]
    assert len(results["runs"]) == len(names) == len(set(names))
    assert results["finished"]
    assert "+" not in results["commit"]  # of a tree without changes


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_tables_are_what_the_program_writes_of_the_runs(folder):
    results = read(folder, "results.json")
    experiment = parse_command(results["command"]).experiment
    summary = experiment.summarise(results["runs"])
    assert json.loads(json.dumps(summary)) == pytest.approx(results["summary"]) or summary == results["summary"]
    assert (folder / "table.md").read_text(encoding="utf-8") == page(results)
    begin, end = block(folder.name)
    assert f"{begin}\n{page(results)}\n{end}" in PAGE


def test_the_page_shows_no_other_results():
    assert PAGE.count("<!-- end of ") == len(FOLDERS)
    assert all(f"| {word}" not in PAGE.split("<!--")[0] for word in ("task", "arm"))
