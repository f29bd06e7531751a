"""Freed memory that the process keeps."""

import subprocess
import sys

import pytest

from evogymcm.algos.learning import memory

_FAULTS = """
import resource, runpy, sys
import numpy as np

keep_freed_memory = runpy.run_path(sys.argv[1])["keep_freed_memory"]  # without torch, which takes seconds to load

def faults():
    np.empty(1 << 20).fill(1)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(50):
        a, b = np.empty(1 << 20), np.empty(1 << 20)  # 8 MB each, as a gradient step's
        a.fill(1), b.fill(1)
        del a, b
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

freed = faults()
assert keep_freed_memory()
print(freed, faults())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's setting")
def test_memory_is_faulted_in_once():
    command = [sys.executable, "-c", _FAULTS, memory.__file__]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    freed, kept = map(int, out.split())
    assert kept < 0.2 * freed


def test_elsewhere_it_does_nothing(monkeypatch):
    monkeypatch.setattr(memory.sys, "platform", "darwin")
    assert not memory.keep_freed_memory()
