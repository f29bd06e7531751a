"""Committed results: what they were made with can be asked for today, and what is shown of them is what they hold."""

import json
import re

import pytest

from benchmarks.experiments.options import command_of, parse_command
from benchmarks.experiments.pages import RESULTS, pages

FOLDERS = sorted(RESULTS.iterdir())


def assert_same(recorded, today):
    """Every recorded setting is there today, with the same value; there may be more by now."""
    if not isinstance(recorded, dict):
        assert recorded == today
        return
    assert recorded.keys() <= today.keys()
    for key, value in recorded.items():
        assert_same(value, today[key])


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_what_was_run_can_be_asked_for_today(folder):
    assert {path.name for path in folder.iterdir()} == {"config.json", "results.json", "table.md"}
    config, results = (json.loads((folder / name).read_text()) for name in ("config.json", "results.json"))
    command = config.pop("command")
    options = parse_command(command)
    assert command_of(options.name, options.experiment) == command == results["command"]
    assert config == results["suite"]
    assert_same(config, options.settings())
    assert len(results["runs"]) == len(options.experiment.jobs())
    assert results["finished"]
    assert "+" not in results["commit"]  # of a tree without changes


def test_tables_are_what_the_program_writes_of_the_runs():
    files = pages()
    assert {path.parent for path in files if path.name == "table.md"} == set(FOLDERS)
    for path, text in files.items():
        assert path.read_text(encoding="utf-8") == text, f"{path}: run_suite.py write-docs"
    (shown,) = (text for path, text in files.items() if path.name == "results.md")
    assert sorted(re.findall("<!-- end of (.*) -->", shown)) == [folder.name for folder in FOLDERS]
    figures = re.findall(r"\(img/(.*?)(?:-designs|-stiffness)?\.png\)", shown)
    assert set(figures) <= {folder.name for folder in FOLDERS}
