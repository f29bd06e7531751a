"""Freed memory that the process keeps."""

import subprocess
import sys

import pytest

from evogymcm.algos import memory

_FAULTS = """
import resource
import sys
import numpy as np
from evogymcm.algos import keep_freed_memory
if sys.argv[1] == "keep":
    assert keep_freed_memory()
np.empty(1 << 20).fill(1)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(50):
    a, b = np.empty(1 << 20), np.empty(1 << 20)  # 8 MB each, as a gradient step's
    a.fill(1), b.fill(1)
    del a, b
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def _faults(mode: str) -> int:
    out = subprocess.run([sys.executable, "-c", _FAULTS, mode], check=True, capture_output=True, text=True)
    return int(out.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's setting")
def test_memory_is_faulted_in_once():
    assert _faults("keep") < 0.2 * _faults("leave")


def test_elsewhere_it_does_nothing(monkeypatch):
    monkeypatch.setattr(memory.sys, "platform", "darwin")
    assert not memory.keep_freed_memory()
