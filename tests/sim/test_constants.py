"""Every constant of the physics is held by a test: with one of them 1 % off, a test fails that passes otherwise."""

import os
import subprocess
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from evogymcm.sim import constants, parts, simulator, topology, worlds
from evogymcm.sim.constants import H_ACT, RIGID, SOFT, V_ACT, Physics
from tests.sim import test_golden as golden

ROOT = Path(__file__).resolve().parents[2]
OFF = 1.01
# The springs of fixed voxels join fixed points: their constants have no effect (test_rare_paths.py reads them).
SPRINGS = [("EDGE_CONSTANT", code) for code in (RIGID, SOFT, H_ACT, V_ACT)]
SPRINGS += [("DIAGONAL_CONSTANT", code) for code in (RIGID, SOFT, H_ACT, V_ACT)]
SMALLEST_FIRST = sorted(golden.RECORDS, key=lambda name: golden.RECORDS[name].stat().st_size)
LIMITS = (
    "STRETCH_LIMIT",
    "SQUEEZE_LIMIT",
    "LIMIT_GAIN",
    "RIGID_STRETCH_LIMIT",
    "RIGID_SQUEEZE_LIMIT",
    "RIGID_LIMIT_GAIN",
)


def is_noticed():
    """Whether one of the recorded roll-outs is no longer followed."""
    for name in SMALLEST_FIRST:
        try:
            golden.test_every_bit_is_the_references(name)
        except AssertionError:
            return True
    return False


@pytest.fixture
def fresh_topologies():
    """Bodies are looked up by their grid: none must be left that was made of other constants."""
    topology._build.cache_clear()
    yield
    topology._build.cache_clear()


@pytest.mark.slow
def test_unchanged_constants_are_not_noticed():
    assert not is_noticed()


@pytest.mark.slow
@pytest.mark.parametrize("name", list(asdict(Physics())))
def test_a_constant_of_the_integration_or_contact_is_held(name, monkeypatch):
    changed = {name: OFF * getattr(Physics(), name)}
    monkeypatch.setattr(worlds, "Physics", partial(Physics, **changed))
    assert is_noticed()


@pytest.mark.slow
@pytest.mark.usefixtures("fresh_topologies")
@pytest.mark.parametrize(("table", "code"), SPRINGS)
def test_a_spring_constant_is_held(table, code, monkeypatch):
    values = getattr(constants, table).copy()
    values[code] *= OFF
    monkeypatch.setattr(topology, table, values)
    assert is_noticed()


@pytest.mark.slow
@pytest.mark.parametrize("length", [0.1, np.sqrt(0.02)], ids=["edge", "diagonal"])
def test_a_rest_length_is_held(length, monkeypatch):
    springs = parts.object_springs

    def off(*args, **options):
        found = springs(*args, **options)
        return found._replace(rest=np.where(np.isclose(found.rest, length), OFF * found.rest, found.rest))

    monkeypatch.setattr(parts, "object_springs", off)
    assert is_noticed()


@pytest.mark.slow
@pytest.mark.usefixtures("fresh_topologies")
def test_the_width_of_a_voxel_is_held(monkeypatch):
    monkeypatch.setattr(topology, "VOXEL", OFF * constants.VOXEL)
    assert is_noticed()


@pytest.mark.slow
def test_the_number_of_substeps_is_held(monkeypatch):
    monkeypatch.setattr(simulator, "SUBSTEPS", constants.SUBSTEPS + 1)
    assert is_noticed()


# Limits on lengths are compiled into the kernels. With the JIT off the same kernels look them up at every call.
LIMITS_CODE = f"""
from evogymcm.sim.kernels import springs
from tests.sim.test_springs import test_a_substep_in_the_air_is_the_twins as compare

def is_noticed():
    for seed in range(3):
        try:
            compare(seed, 0.03, 5.0)
        except AssertionError:
            return True
    return False

assert not is_noticed()
for name in {LIMITS!r}:
    value = getattr(springs, name)
    setattr(springs, name, {OFF} * value)
    print(name, is_noticed())
    setattr(springs, name, value)
"""


@pytest.mark.slow
def test_limits_on_lengths_are_held():
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", LIMITS_CODE]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:-1] == [f"{name} True" for name in LIMITS]
