"""Random bodies, materials and hard actions: nothing breaks unseen."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "fuzz.py"


@pytest.fixture(scope="module")
def fuzz():
    spec = importlib.util.spec_from_file_location("fuzz", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["fuzz"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_a_few_steps(fuzz):
    summary = fuzz.fuzz(3_000, seed=1)
    assert summary.env_steps >= 3_000
    assert summary.compared > 0


@pytest.mark.slow
def test_many_steps(fuzz):
    summary = fuzz.fuzz(60_000, seed=2)
    assert summary.env_steps >= 60_000
    assert summary.unstable > 0  # otherwise the throw was not hard enough


@pytest.mark.slow
def test_no_index_is_out_of_range_in_any_world(tmp_path):
    # A short form of scripts/bounds.sh, in a process of its own: its kernels check every index.
    variables = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, SCRIPT, "--worlds", "3"]
    variables["PYTHONPATH"] = str(SCRIPT.parents[1])
    subprocess.run(command, env=variables, check=True, capture_output=True, timeout=900)
