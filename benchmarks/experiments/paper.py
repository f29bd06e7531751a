"""What the EvoGymCM paper and EvoGym have published: robots, names of arms, scores."""

from collections.abc import Mapping
from dataclasses import dataclass

from evogymcm.algos.learning.config import Material

CONTROL, TREATED = "control-only", "co-optimisation"
FIXED_ARMS: Mapping[str, Material] = {CONTROL: "invariant", TREATED: "reactive"}  # experiment A's -> material


@dataclass(frozen=True)
class PaperRow:
    """A row of the paper's Table I: robot, and mean and standard deviation of the score over three seeds."""

    robot: str
    scores: Mapping[str, tuple[float, float]]


def _row(robot: str, control: tuple[float, float], treated: tuple[float, float]) -> PaperRow:
    return PaperRow(robot, {CONTROL: control, TREATED: treated})


PAPER: Mapping[str, PaperRow] = {
    "Walker-v0": _row("Walk_Bot", (9.46, 0.03), (9.55, 0.01)),
    "BridgeWalker-v0": _row("Bridge_Bot", (2.10, 0.23), (2.97, 0.24)),
    "DownStepper-v0": _row("Down_Bot", (3.25, 0.27), (3.92, 0.16)),
    "CaveCrawler-v0": _row("Cave_Bot", (2.02, 0.01), (2.03, 0.01)),
    "AreaMaximizer-v0": _row("Amax_Bot", (0.62, 0.07), (0.74, 0.14)),
    "AreaMinimizer-v0": _row("Amin_Bot", (0.61, 0.04), (0.69, 0.04)),
}
PUBLISHED_BODIES = 100  # trained in all by published runs of EvoGym's genetic algorithm
PUBLISHED: Mapping[str, float] = {  # best returns of those runs
    "Walker-v0": 10.55,
    "BridgeWalker-v0": 3.87,
    "DownStepper-v0": 4.90,
    "CaveCrawler-v0": 4.41,
    "AreaMaximizer-v0": 2.52,
    "AreaMinimizer-v0": 0.81,
}
