"""Whether this machine computes the bits that the package was released with, and if not, which part differs.

Each part is a hash of numbers that depend on as little as possible besides: what the C library computes, springs alone,
contact without friction (which takes a tanh), readings without an angle (which takes an acos), then whole tasks.
"""

import json
import math
import platform
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

import numpy as np

from evogymcm._files import write_atomic
from evogymcm._messages import some
from evogymcm.body import as_body
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.task import Task
from evogymcm.envs.tasks import own_tasks
from evogymcm.sim.constants import ACTUATION_HIGH, ACTUATION_LOW, FIXED, SOFT, STIFFNESS_HIGH, STIFFNESS_LOW, Physics
from evogymcm.sim.kernels._jit import kernel
from evogymcm.sim.kernels.readings import ORIENTATION
from evogymcm.sim.simulator import Simulator
from evogymcm.sim.world import ROBOT, World, WorldObject

REFERENCE = Path(__file__).parents[1] / "selfcheck.json"
N_SETTINGS, ENV_STEPS = 2, 40  # of every task, and in each of them
_HELD = 4  # env-steps that an action is held
_STANDARD, _SMALL = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV", "RHSV/HRSV/V..S"
_SUBSTEPS = 20  # of the parts, which also run without the JIT
_N_ARGUMENTS = 1 << 16
# With so little friction a tanh is 1, or its argument, in any library, and changes no force.
_FRICTIONLESS = Physics(friction=1e-200)

Kind = Literal["library", "arithmetic", "physics", "observations"]
_CAUSES: dict[Kind, set[str]] = {"physics": {"tanh"}, "observations": {"tanh", "acos"}}  # what these take of libraries


class Part(NamedTuple):
    """A hash, beside that of the package.

    Attributes:
        name: What was computed: a part's name or a task's id.
        kind: "library" (functions that are not the package's), "arithmetic" (what needs none of these), or a whole
            simulation's "physics" (positions and velocities) or "observations" (with rewards).
        found: The hash here.
        expected: That of the package, None where it has none.
    """

    name: str
    kind: Kind
    found: str
    expected: str | None

    @property
    def is_equal(self) -> bool:
        """Whether the bits are the package's."""
        return self.found == self.expected


@dataclass(frozen=True)
class SelfCheck:
    """What `selfcheck` found.

    Attributes:
        parts: All parts.
        machine: This machine: processor, C library, versions.
        reference: The machine of the package's hashes.
    """

    parts: tuple[Part, ...]
    machine: dict[str, str]
    reference: dict[str, str]

    @property
    def is_equal(self) -> bool:
        """Whether all bits are the package's."""
        return all(part.is_equal for part in self.parts)

    def differing(self, *kinds: Kind) -> list[str]:
        """Returns the names of the parts of these kinds (of all without any) that differ."""
        return [part.name for part in self.parts if not part.is_equal and (not kinds or part.kind in kinds)]

    @property
    def verdict(self) -> str:
        """What differs, in a sentence or two."""
        if self.is_equal:
            return "All bits are the package's."
        if arithmetic := self.differing("arithmetic"):
            return (
                f"The arithmetic differs ({', '.join(arithmetic)}), which it should nowhere: operations are rounded "
                "otherwise, perhaps fused. Please report it with the output of --json."
            )
        library = set(self.differing("library"))
        odd = [name for kind, causes in _CAUSES.items() if not causes & library for name in self.differing(kind)]
        if odd:
            return (
                f"Arithmetic and library functions are the package's, but {some(dict.fromkeys(odd))} differ. "
                "Please report it with the output of --json."
            )
        return (
            f"Only functions outside the package differ ({', '.join(self.differing('library'))}). Springs, contact "
            "without friction and readings are the package's; what takes these functions may differ by rounding."
        )

    def as_dict(self) -> dict[str, Any]:
        """Returns everything as JSON has it."""
        parts = [part._asdict() | {"is_equal": part.is_equal} for part in self.parts]
        machines = {"machine": self.machine, "reference": self.reference}
        return {"is_equal": self.is_equal, "verdict": self.verdict} | machines | {"parts": parts}

    def write(self) -> None:
        """Makes the hashes found here those of the package."""
        hashes: dict[str, dict[str, str]] = {}
        for part in self.parts:
            hashes.setdefault(part.kind, {})[part.name] = part.found
        text = json.dumps({"machine": self.machine} | hashes, indent=1) + "\n"
        write_atomic(REFERENCE, lambda part: part.write_text(text, encoding="utf-8"))


def selfcheck(tasks: Sequence[str] | None = None, progress: Callable[[int], object] | None = None) -> SelfCheck:
    """Computes short simulations, always the same, and compares every bit with what the package was released with.

    It takes about a second, once the kernels are compiled.

    Args:
        tasks: Ids of the package's tasks to simulate; all of them by default. The parts of which they are made are
            always compared.
        progress: Called with the env-steps of tasks done so far, `ENV_STEPS` for each in each of `N_SETTINGS`.

    Raises:
        ValueError: For an id that is not the package's.
    """
    known = own_tasks()
    chosen = list(known if tasks is None else tasks)
    if unknown := [name for name in chosen if name not in known]:
        raise ValueError(f"tasks: got {', '.join(map(repr, unknown))}, allowed are the package's: {', '.join(known)}")
    reference = json.loads(REFERENCE.read_text(encoding="utf-8")) if REFERENCE.is_file() else {}
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done)

    found = [*_parts(), *(part for name in chosen for part in _task(known[name], count))]
    parts = (Part(name, kind, digest, reference.get(kind, {}).get(name)) for name, kind, digest in found)
    return SelfCheck(tuple(parts), _machine(), reference.get("machine", {}))


def _machine() -> dict[str, str]:
    """Returns what bits may depend on."""
    from llvmlite import binding
    from numba import config

    versions = {name: version(name) for name in ("numba", "llvmlite", "numpy")}
    compiler = "off" if config.DISABLE_JIT else config.CPU_NAME or binding.get_host_cpu_name()
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "compiled_for": compiler,
        "c_library": " ".join(platform.libc_ver()).strip() or platform.platform(),
        "svml": str(bool(config.USING_SVML)).lower(),
        "python": platform.python_version(),
    } | versions


class _Draws:
    """Random numbers that no version of another package changes: a counter, mixed (Steele et al., 2014, SplitMix64)."""

    def __init__(self, seed: int) -> None:
        self._state = seed << 32

    def uniform(self, low: float, high: float, shape: tuple[int, ...]) -> np.ndarray:
        """Returns numbers in [low, high)."""
        n = math.prod(shape)
        x = (np.arange(1, n + 1, dtype=np.uint64) + np.uint64(self._state)) * np.uint64(0x9E3779B97F4A7C15)
        self._state += n
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
            x = (x ^ (x >> np.uint64(shift))) * np.uint64(factor)
        unit = ((x ^ (x >> np.uint64(31))) >> np.uint64(11)).astype(np.float64) * 2.0**-53
        return (low + (high - low) * unit).reshape(shape)

    def action(self, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Returns actuation and stiffness."""
        return self.uniform(ACTUATION_LOW, ACTUATION_HIGH, shape), self.uniform(STIFFNESS_LOW, STIFFNESS_HIGH, shape)

    def integers(self, low: int, high: int, endpoint: bool = False) -> int:
        """Returns a whole number, as tasks draw it from numpy's generators."""
        return low + int(self.uniform(0.0, float(high - low + endpoint), (1,))[0])


def _hash(arrays: Iterable[np.ndarray]) -> str:
    """Returns 16 digits that change with any bit of the numbers."""
    digest = sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()[:16]


@kernel
def _call_c_library(x: np.ndarray, cosines: np.ndarray, tanh: np.ndarray, acos: np.ndarray) -> None:
    for i in range(x.shape[0]):
        tanh[i] = math.tanh(x[i])
        acos[i] = math.acos(cosines[i])


def _points(sim: Simulator) -> Iterator[np.ndarray]:
    """Yields positions and velocities of all objects of the first world."""
    for placed in sim.objects():
        yield sim.positions(placed.name)
        yield sim.velocities(placed.name)


def _shaken(world: World, physics: Physics | None = None) -> Simulator:
    """Returns a world with a robot whose points were displaced, after a few substeps."""
    sim, draws = Simulator([world.simulation_order()], "mean_stiffness", physics, num_threads=1), _Draws(1)
    points = sim.points()
    former = points + draws.uniform(-0.018, 0.018, points.shape)
    now = former + draws.uniform(-1e-4, 1e-4, points.shape)
    sim.set_points(now, draws.uniform(-1.0, 1.0, points.shape), former)
    sim.substeps(_SUBSTEPS, *draws.action((1, sim.n_cells)))
    return sim


def _turned() -> TaskEngine:
    """Returns worlds in which the robot was turned by 0, 1, 2, 3 right angles, and its points displaced."""
    draws = _Draws(3)
    engine = TaskEngine("CaveCrawler-v0", _SMALL, 16, material="reactive", num_threads=1)
    for world in range(engine.num_worlds):
        points = engine.simulator.points(world)
        n = engine.simulator.positions("robot", world).shape[1]
        centre = points[:, :1].copy()
        x, y = points[:, :n] - centre
        turned = np.stack([(x, y), (-y, x), (-x, -y), (y, -x)][world % 4])
        points[:, :n] = centre + turned + draws.uniform(-0.018, 0.018, (2, n))
        engine.simulator.set_points(points, draws.uniform(-1.0, 1.0, points.shape), points, world)
    engine.refresh()
    return engine


def _parts() -> Iterator[tuple[str, Kind, str]]:
    """Yields the parts that tasks are made of: name, kind, hash."""
    x = _Draws(0).uniform(-1.0, 1.0, (_N_ARGUMENTS,))
    wide = x * 2.0 ** (np.arange(_N_ARGUMENTS) % 16 - 10)  # up to 32: from where tanh is its argument to where it is 1
    tanh, acos = np.empty_like(x), np.empty_like(x)
    _call_c_library(wide, x, tanh, acos)
    yield "tanh", "library", _hash([tanh])
    yield "acos", "library", _hash([acos])
    angles = math.pi * (x + 1.0)
    yield "sin, cos", "library", _hash([np.sin(angles), np.cos(angles)])

    grid = as_body(_SMALL).grid
    air = World(12, 12).place(WorldObject(ROBOT, grid, (2, 6)))
    yield "springs", "arithmetic", _hash(_points(_shaken(air)))
    ground = World(12, 12).place(WorldObject("wall", np.full((2, 1), FIXED), (6, 0)))
    ground = ground.place(WorldObject("box", np.full((1, 2), SOFT), (3, 3))).place(WorldObject(ROBOT, grid, (2, 0)))
    yield "contact", "arithmetic", _hash(_points(_shaken(ground, _FRICTIONLESS)))

    engine = _turned()
    now = engine.snapshot
    numbers = now.robot.numbers.copy()
    angles, numbers[:, ORIENTATION] = numbers[:, ORIENTATION].copy(), 0.0
    windows = [window for window in (now.floor, now.ceiling) if window is not None]
    yield "readings", "arithmetic", _hash([numbers, now.robot.relative, engine.voxels, *windows])
    yield "friction", "physics", _hash(_points(_shaken(ground)))
    yield "orientation", "observations", _hash([angles])


def _task(task: Task, count: Callable[[], None]) -> Iterator[tuple[str, Kind, str]]:
    """Yields the hashes of a task's physics and observations, both settings together: name, kind, hash."""
    draws = _Draws(2)
    physics: list[np.ndarray] = []
    observations: list[np.ndarray] = []
    field = draws.uniform(STIFFNESS_LOW, STIFFNESS_HIGH, as_body(_SMALL).shape)
    settings: tuple[dict[str, Any], ...] = (
        {"bodies": _STANDARD, "material": "reactive"},
        {"bodies": _SMALL, "material": "invariant", "stiffness": field, "edge_rule": "mean_stiffness"},
    )
    for setting in settings:
        engine = TaskEngine(task, **setting, num_threads=1)
        engine._rngs = [cast(np.random.Generator, draws)]
        engine.reset()
        shape = engine.occupancy.shape
        for step in range(ENV_STEPS):
            if step % _HELD == 0:
                actuation, stiffness = draws.action(shape)
            engine.step(actuation, stiffness if engine.material == "reactive" else None)
            physics += _points(engine.simulator)
            flat = engine.flat
            observations += [engine.reward, engine.voxels, *([] if flat is None else [flat])]
            count()
    yield task.id, "physics", _hash(physics)
    yield task.id, "observations", _hash(observations)
