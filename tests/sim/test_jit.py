"""Kernels on disk: loaded while all sources are as they were, compiled anew when any has changed."""

import importlib.util

import pytest

from evogymcm.sim.kernels import _jit

KERNEL = """
from evogymcm.sim.kernels._jit import kernel

@kernel
def double(x):
    return 2.0 * x
"""


def test_a_kernel_on_disk_is_used_only_with_the_sources_that_it_was_compiled_from(tmp_path, monkeypatch):
    path = tmp_path / "kernels.py"
    path.write_text(KERNEL, encoding="utf-8")
    hits = []
    for sources in ("first", "first", "second", "second"):  # the kernel's own file, which numba looks at, stays
        monkeypatch.setattr(_jit, "_SOURCES", sources)
        spec = importlib.util.spec_from_file_location("kernels", path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        assert module.double(1.5) == 3.0
        if not hasattr(module.double, "stats"):
            pytest.skip("the JIT is off")
        hits.append(sum(module.double.stats.cache_hits.values()))
    assert hits == [0, 1, 0, 1]
