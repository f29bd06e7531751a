"""Writes the table of tasks in README.md and docs/tasks.md from the registry.

    python docs/task_table.py            # prints the table
    python docs/task_table.py --write    # puts it into both files

What the tasks ask for is written here; episode lengths and ceilings are read off the tasks.
"""

import argparse
from pathlib import Path

import numpy as np

import evogymcm as cm
from evogymcm.envs import TaskEngine

FILES = (Path(__file__).resolve().parents[1] / "README.md", Path(__file__).resolve().parent / "tasks.md")
BEGIN, END = "<!-- tasks: written by docs/task_table.py -->\n", "<!-- end of tasks -->\n"
BODY = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"
WHAT = {
    "Walker-v0": "walk on flat ground",
    "BridgeWalker-v0": "cross a soft bridge",
    "DownStepper-v0": "go down stairs",
    "CaveCrawler-v0": "get through a low cave",
    "AreaMaximizer-v0": "grow the convex hull",
    "AreaMinimizer-v0": "shrink the convex hull",
    "WingspanMazimizer-v0": "grow wide",
    "HeightMaximizer-v0": "grow tall",
    "BidirectionalWalker-v0": "walk to and fro between random goals",
    "UpStepper-v0": "climb stairs",
    "ObstacleTraverser-v0": "walk over bumps",
    "ObstacleTraverser-v1": "walk over rough ground",
    "Hurdler-v0": "get over hurdles",
    "PlatformJumper-v0": "move along platforms at different heights",
    "GapJumper-v0": "move along platforms with gaps",
    "Traverser-v0": "cross a pit of loose blocks",
    "Carrier-v0": "carry a soft package",
    "Carrier-v1": "carry a rigid package to a table",
    "Pusher-v0": "push a soft package",
    "Pusher-v1": "drag a rigid package",
    "Thrower-v0": "throw a package",
    "Catcher-v0": "catch a package that falls from a random place",
    "BeamToppler-v0": "topple a beam",
    "BeamSlider-v0": "slide a beam",
    "Lifter-v0": "lift a package out of a pit",
    "Climber-v0": "climb a pipe",
    "Climber-v1": "climb a pipe with soft walls",
    "Climber-v2": "climb a winding pipe",
    "Flipper-v0": "turn over and over",
    "Jumper-v0": "jump on the spot",
    "Balancer-v0": "balance on a pole",
    "Balancer-v1": "get onto a pole",
    "CaveCrawler-v1": "climb through a cave",
    "HoleCrawler-v0": "get through a hole",
}


def ceiling(task: str) -> str:
    """Returns the score ceiling of the standard body, empty where none is known."""
    value = TaskEngine(task, BODY, num_threads=1, with_voxels=False).score_ceiling[0]
    return "" if np.isnan(value) else f"{value:.2f}"


def table() -> str:
    """Returns the table in Markdown: the tasks of the EvoGymCM paper, then the others."""
    order = [*WHAT, *sorted(set(cm.tasks) - set(WHAT))]
    rows = ["| id | what to do | episode | score ceiling |", "| --- | --- | --- | --- |"]
    for task in order:
        if task in cm.tasks:
            rows.append(f"| `{task}` | {WHAT.get(task, '')} | {cm.tasks[task].time_limit} | {ceiling(task)} |")
    return "\n".join(rows) + "\n"


def main() -> None:
    """Prints the table, or writes it into its files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put it into README.md and docs/tasks.md")
    if not parser.parse_args().write:
        print(table(), end="")
        return
    for path in FILES:
        before, rest = path.read_text(encoding="utf-8").split(BEGIN)
        path.write_text(before + BEGIN + "\n" + table() + "\n" + END + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
