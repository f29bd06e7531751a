"""`evogymcm warmup`: compile the kernels and keep them on disk, so that nothing has to wait for it later."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

DESCRIPTION = """Compiles the simulator (about 20 s) and keeps it on disk. Without it the first simulation does
the same. Where that is done already, it takes a moment.

examples:
  evogymcm warmup"""


@dataclass(frozen=True)
class Options:
    """There are none."""


def run(options: Options, arguments: Sequence[str]) -> int:
    """Steps one world of a task that uses every kernel."""
    import numpy as np

    from evogymcm.envs.core import TaskEngine

    start = time.perf_counter()
    for task in ("CaveCrawler-v0", "AreaMaximizer-v0"):
        engine = TaskEngine(task, "HH/VV", 1, material="reactive", num_threads=1)
        ones = np.ones(engine.occupancy.shape)
        engine.step(ones, ones)
    print(f"kernels ready in {time.perf_counter() - start:.1f} s")
    return 0
