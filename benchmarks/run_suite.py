"""Runs the EvoGymCM paper's experiments, and the studies beside them.

    python benchmarks/run_suite.py A                                 # fixed robots, minutes
    python benchmarks/run_suite.py B --size small                    # evolved robots with stiffness control
    python benchmarks/run_suite.py C --size paper --seeds 3 4        # evolved robots with searched stiffness fields
    python benchmarks/run_suite.py A --tasks AreaMinimizer-v0 --ppo.initial-std 2
    python benchmarks/run_suite.py write-docs                        # tables and figures of docs/results.md

Every experiment has three sizes, "quick", "small" and "paper", and every field of its settings can be set besides:
`run_suite.py A --help` lists those of A.
"""

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # instead of this file's folder: `benchmarks` is a package
    from benchmarks.experiments.program import main

    sys.exit(main(sys.argv[1:]))
