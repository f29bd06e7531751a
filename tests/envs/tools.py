"""What several tests of this folder share: bodies, random actions, and slow numpy twins of the readings."""

import itertools
import math

import gymnasium
import numpy as np

from evogymcm.envs import TaskEngine

MATERIALS = ("invariant", "reactive")
PAPER_TASKS = (
    "Walker-v0",
    "BridgeWalker-v0",
    "DownStepper-v0",
    "CaveCrawler-v0",
    "AreaMaximizer-v0",
    "AreaMinimizer-v0",
)
PAPER_ROBOTS = dict(
    zip(PAPER_TASKS, ("Walk_Bot", "Bridge_Bot", "Down_Bot", "Cave_Bot", "Amax_Bot", "Amin_Bot"), strict=True)
)
SMALL, WIDE, TALL = "HVH/S.R", "RHSV/H..H", "VV./.HS/HHH"  # 2x3, 2x4, 3x3


def random_actions(engine, steps, seed=0):
    """(steps, N, V) actuation and stiffness."""
    rng = np.random.default_rng(seed)
    shape = (steps, *engine.occupancy.shape)
    return rng.uniform(0.6, 1.6, shape), rng.uniform(0.5, 2.0, shape)


def step_randomly(engine, steps, seed=0):
    """Advances an engine by random actions."""
    for actuation, stiffness in zip(*random_actions(engine, steps, seed), strict=True):
        engine.step(actuation, stiffness if engine.material == "reactive" else None)


def outputs(engine):
    """Copies of everything that an engine shows after a step, by name."""
    names = ("voxels", "types", "features", "com", "reward", "score", "returns", "length")
    flags = ("terminated", "truncated", "unstable", "reached", "stiffness", "actuation")
    shown = {name: np.array(getattr(engine, name)) for name in names + flags}
    return shown if engine.flat is None else shown | {"flat": engine.flat}


def assert_same(got, expected, rows=slice(None)):
    """All outputs are equal bit for bit, in the rows given."""
    assert got.keys() == expected.keys()
    for name in got:
        np.testing.assert_array_equal(got[name][rows], expected[name][rows], err_msg=name)


def move(engine, x=0.0, y=0.0, world=0):
    """Shifts a robot and lets the engine read it anew."""
    engine.simulator.move("robot", (x, y), world)
    engine.refresh()


def turn(engine, angle, world=0):
    """Turns a robot counter-clockwise about its COM, and lets the engine read it anew."""
    simulator = engine.simulator
    xy = simulator.points(world)
    n = simulator.positions("robot", world).shape[1]
    center = xy[:, :n].mean(1, keepdims=True)
    xy[:, :n] = rotation(angle) @ (xy[:, :n] - center) + center
    velocities = [simulator.velocities(placed.name, world) for placed in simulator.objects(world)]
    simulator.set_points(xy, np.concatenate(velocities, axis=1), xy, world)
    engine.refresh()


def rotation(angle):
    """(2, 2) matrix that turns column vectors counter-clockwise."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def slow_orientation(was, now):
    """EvoGym's orientation of (2, n) points against those at reset, in [0, 2 pi)."""
    a, b = was - was.mean(1, keepdims=True), now - now.mean(1, keepdims=True)
    length_a, length_b = np.sqrt((a**2).sum(0)), np.sqrt((b**2).sum(0))
    angles = []
    for i in range(a.shape[1]):
        cosine = 0.99999
        if length_a[i] * length_b[i] >= 1e-7:
            cosine = float(a[:, i] @ b[:, i]) / (length_a[i] * length_b[i])
        angles.append(math.acos(0.99999 if cosine > 1 else -0.99999 if cosine < -1 else cosine))
    phi = float(length_a @ np.array(angles) / length_a.sum())
    unit_a = np.divide(a, length_a, out=np.zeros_like(a), where=length_a > 0)
    unit_b = np.divide(b, length_b, out=np.zeros_like(b), where=length_b > 0)
    return 2 * 3.1415926 - phi if (unit_b[0] * unit_a[1] - unit_b[1] * unit_a[0]).sum() > 0 else phi


def slow_window(terrain, com, radius, is_ceiling):
    """An elevation window over (2, n) points, all in metres, column by column."""
    x, y = terrain / 0.1
    cx, cy = com / 0.1
    seen = []
    for i in range(-radius, radius + 1):
        column = (x > cx + (i - 0.5)) & (x < cx + (i + 0.5)) & (y > cy if is_ceiling else y < cy)
        distances = y[column] - cy if is_ceiling else cy - y[column]
        seen.append(0.1 * min([*distances.tolist(), 5.0]))
    return np.array(seen)


def slow_hull_area(points):
    """Area of the convex hull of (2, n) points: the edges are the pairs with no point to their right."""
    xy = np.unique(points.T, axis=0)
    area = 0.0
    for a, b in itertools.permutations(range(len(xy)), 2):
        side = _cross(xy[b] - xy[a], xy - xy[a])
        on_line = np.abs(side) < 1e-12
        along = (xy - xy[a]) @ (xy[b] - xy[a]) / ((xy[b] - xy[a]) @ (xy[b] - xy[a]))
        if (side[~on_line] > 0).all() and (along[on_line] > -1e-9).all() and (along[on_line] < 1 + 1e-9).all():
            area += float(_cross(xy[a], xy[b])) / 2
    return area


def _cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def make_engine(task="Walker-v0", bodies="Walk_Bot", num_worlds=None, **options):
    """A task engine with one thread."""
    return TaskEngine(task, bodies, num_worlds, **{"num_threads": 1, "seed": 0} | options)


def make_gymnasium(task="Walker-v0", body="Walk_Bot", **options):
    """A registered environment of one world."""
    return gymnasium.make(f"evogymcm/{task}", body=body, **options)


def make_vec(task="Walker-v0", body="Walk_Bot", num_envs=4, **options):
    """A registered vector environment with one thread."""
    return gymnasium.make_vec(f"evogymcm/{task}", num_envs=num_envs, body=body, **{"num_threads": 1} | options)


def draw(space, steps, seed=0):
    """Samples of a space, one for each step."""
    space.seed(seed)
    return [space.sample() for _ in range(steps)]
