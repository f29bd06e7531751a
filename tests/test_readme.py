"""The README: its code runs, and its table is the registry's."""

import re
import runpy
from pathlib import Path

import pytest

from evogymcm.envs import tasks as task_package
from evogymcm.envs.tasks import own_tasks
from tests.examples import NAMES, shown

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
EXAMPLES = {name: shown(name) for name in NAMES}


@pytest.mark.usefixtures("own_registries")
@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.split("\n")[0][:40])
def test_block_runs(block, tmp_path, monkeypatch):
    if block in EXAMPLES.values():
        pytest.skip("run by test_examples.py")
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "README.md", "exec"), {"__name__": "readme"})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["train", "collector"])
def test_examples_are_shown_as_they_are(name):
    assert f"`examples/{name}.py`" in TEXT
    assert EXAMPLES[name] in BLOCKS


def test_files_named_exist():
    for name in re.findall(r"(?:examples|docs|tests|evogymcm|scripts|benchmarks)/[\w./-]*", TEXT):
        is_gymnasium_id = re.fullmatch(r"evogymcm/\w+-v\d+", name)
        assert is_gymnasium_id or (ROOT / name).exists(), name


@pytest.mark.usefixtures("own_registries")
def test_table_is_the_registrys():
    own = own_tasks()
    task_package._REGISTRY.clear()  # of what other tests have registered
    task_package._REGISTRY.update(own)
    table = runpy.run_path(str(ROOT / "docs" / "task_table.py"))["table"]().strip()
    for path in (ROOT / "README.md", ROOT / "docs" / "tasks.md"):
        shown = re.search(r"<!-- tasks: .*? -->(.*?)<!-- end of tasks -->", path.read_text(encoding="utf-8"), re.DOTALL)
        assert shown[1].strip() == table, "run: python docs/task_table.py --write"
    for task in own_tasks().values():
        assert task.about
        assert f"| `{task.id}` | {task.about} | {task.time_limit} |" in table


def test_world_picture_is_the_packages():
    (picture,) = re.findall(r"```text\n(.*?)```", TEXT, re.DOTALL)
    stored = (ROOT / "evogymcm" / "sim" / "worlds" / "Lifter-v0.txt").read_text(encoding="utf-8")
    assert picture.strip() in stored
