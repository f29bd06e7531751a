"""The scripts of other libraries' users, those whose libraries are here; scripts/clients.sh runs all."""

import ast
import importlib
import os
import runpy
import subprocess
import sys

import pytest

from tests.clients.recipe import blocks
from tests.clients.run import scripts

QUICK = {"cleanrl_ppo", "pettingzoo_wrappers", "pyribs_cma_mae", "sb3_vec"}
SLOW = {"sb3_single", "torchrl_sac"}  # the others start processes, or have libraries that are not here


def skip_without_its_libraries(name):
    """Skips a test where a script's imports fail, such as those of Ray where it was installed without RLlib."""
    for node in ast.walk(ast.parse(scripts()[name].read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            try:
                importlib.import_module(node.module)
            except ImportError as error:
                pytest.skip(f"{error}: run scripts/clients.sh {name}")


def test_scripts_have_recipes():
    assert set(scripts()) > QUICK
    assert all(blocks(name) for name in scripts())


@pytest.mark.parametrize(
    "name", [*sorted(QUICK), *(pytest.param(name, marks=pytest.mark.slow) for name in sorted(SLOW))]
)
def test_script(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    skip_without_its_libraries(name)
    runpy.run_path(str(scripts()[name]))["main"]()


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(scripts()) - QUICK - SLOW))
def test_script_in_a_process(name, tmp_path):
    skip_without_its_libraries(name)
    command = [sys.executable, str(scripts()[name])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
