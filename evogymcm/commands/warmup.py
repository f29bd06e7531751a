"""`evogymcm warmup`: compile the kernels and keep them on disk, so that nothing waits for it later."""

import argparse
import time
from typing import Any

_DESCRIPTION = """Compiles the simulator (about 25 s) and keeps it on disk. Without it the first simulation does
the same; where the machine code is there already, this takes a moment."""


def add_parser(subparsers: Any) -> None:
    """Adds the command to a parser."""
    parser = subparsers.add_parser(
        "warmup",
        help="compile the simulator once and keep it on disk",
        description=_DESCRIPTION,
        epilog="examples:\n  evogymcm warmup",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)


def run(_: argparse.Namespace) -> int:
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
