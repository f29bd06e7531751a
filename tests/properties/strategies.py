"""What the library takes, as hypothesis draws it: bodies, worlds, tasks, streams, actions, and junk instead of them."""

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from evogymcm.body import Body, full_connections
from evogymcm.envs import Window
from evogymcm.envs.tasks.walking import Walking
from evogymcm.sim.world import World, WorldObject

SEEDS = st.integers(0, 2**32 - 1)
GROUND = WorldObject("ground", np.full((1, 24), 5), (0, 0))


def _piece(grid):
    """Empties all cells of a grid that are not joined to its first voxel, which an empty one gets."""
    if not grid.any():
        grid[0, 0] = 3
    kept = np.zeros(grid.shape, bool)
    kept.flat[np.flatnonzero(grid)[0]] = True
    while True:
        grown = np.pad(kept, 1)
        grown = grown[1:-1, 1:-1] | grown[:-2, 1:-1] | grown[2:, 1:-1] | grown[1:-1, :-2] | grown[1:-1, 2:]
        grown &= grid > 0
        if (grown == kept).all():
            return np.where(kept, grid, 0)
        kept = grown


def grids(largest, codes):
    """Grids of cells, any codes anywhere."""
    shapes = st.tuples(st.integers(1, largest), st.integers(1, largest))
    return shapes.flatmap(lambda shape: arrays(np.int8, shape, elements=st.sampled_from(codes)))


@st.composite
def joints(draw, grid):
    """Connections of a grid: all of its neighbours, or some."""
    full = full_connections(grid)
    if draw(st.booleans()):
        return None
    return full[:, draw(arrays(bool, full.shape[1]))]


@st.composite
def bodies(draw, largest=4):
    """Valid bodies of all sizes, some with neighbours that are not joined."""
    grid = _piece(draw(grids(largest, range(5))))
    if not (grid >= 3).any():
        grid.flat[np.flatnonzero(grid)[0]] = draw(st.sampled_from([3, 4]))
    return Body(grid, draw(joints(grid)))


def fields(body):
    """Stiffness fields of a body."""
    return arrays(np.float64, body.shape, elements=st.floats(0.5, 2.0))


@st.composite
def objects(draw, name, codes=(0, 1, 2, 5), far=8):
    """Objects of a world: of any cells, not always in one piece, with any of their joints."""
    grid = draw(grids(3, codes))
    if not grid.any():
        grid[0, 0] = draw(st.sampled_from([code for code in codes if code]))
    origin = draw(st.integers(0, far)), draw(st.integers(0, 5))
    return WorldObject(name, grid, origin, draw(joints(grid)))


@st.composite
def worlds(draw, names=None, codes=(0, 1, 2, 5), ground=None, most=3):
    """Worlds of some objects, as far as these do not stand in each other."""
    world = World(1, 1, ())
    if ground is not None:
        world = world.place(ground)
    given = draw(st.lists(names, max_size=most, unique=True)) if names is not None else []
    for name in given or [f"object {i}" for i in range(draw(st.integers(0, most)))]:
        try:
            world = world.place(draw(objects(name, codes)))
        except ValueError:
            continue
    return world


@dataclass(frozen=True)
class Wild(Walking):
    """Walking as far as an episode's own gain pays for, for as long as it has drawn, past objects that it places."""

    def draw(self, rng):
        drawn = {"left": np.array(rng.integers(1, 6)), "pay": rng.uniform(-1.0, 1.0, 1)}
        return drawn | ({"offset": rng.integers(0, 4, 2)} if self.moves_at_reset else {})

    def remember(self, after):
        return after.memory | {"left": after.memory["left"] - 1}

    def reward(self, before, after):
        return after.memory["pay"][:, 0] * super().reward(before, after)

    def endings(self, after):
        yield after.memory["left"] <= 0, 0.5, after.memory["pay"][:, 0] > 0.0


@st.composite
def tasks(draw, largest=3):
    """Tasks in worlds of their own, in which bodies of that size have room: what they watch, observe and place."""
    world = draw(worlds(ground=GROUND))
    names = [obj.name for obj in world.objects]
    some = st.sets(st.sampled_from(names)).map(sorted).map(tuple)
    windows = st.none() | st.builds(Window, some.map(lambda names: names or ("ground",)), st.integers(0, 6))
    watches, floor, ceiling = draw(some), draw(windows), draw(windows)
    parts = ["velocity", "orientation", "relative", *["floor"] * bool(floor), *["ceiling"] * bool(ceiling)]
    kinds = ("offset", "object_velocity", "object_orientation")
    parts += [f"{kind}:{name}" for name in watches for kind in kinds] + [*kinds] * bool(watches)
    observes = draw(st.lists(st.sampled_from(parts), min_size=1, unique=True).map(tuple))
    kind = draw(st.sampled_from([Walking, Wild]))
    moved = ()
    if kind is Wild:
        moved = draw(some.map(lambda names: tuple(name for name in names if name != "ground")))
    top = max(obj.end[1] for obj in world.objects) + 3 * bool(moved)
    spawn = draw(st.integers(0, 8)), top if moved else draw(st.integers(1, top))
    task = kind(
        "Drawn-v0",
        world,
        spawn,
        draw(st.integers(1, 8)),
        observes,
        floor=floor,
        ceiling=ceiling,
        watches=watches,
        moves_at_reset=moved,
        reads_hull=draw(st.booleans()),
    )
    room = WorldObject("robot", np.ones((largest, largest), int), spawn)
    try:
        world.place(room)
    except ValueError:
        return replace(task, spawn=(spawn[0], max(obj.end[1] for obj in world.objects)))
    return task


def actions(shape, seed):
    """(actuation, stiffness) of a shape, as a seed says: uniform, at the ends of their ranges, or far beyond."""
    rng = np.random.default_rng(seed)
    kind = rng.integers(4)
    if kind == 0:
        return rng.uniform(0.6, 1.6, shape), rng.uniform(0.5, 2.0, shape)
    if kind == 1:
        return rng.choice([0.6, 1.6], shape), rng.choice([0.5, 2.0], shape)
    if kind == 2:
        return np.ones(shape), np.full(shape, rng.choice([0.5, 1.0, 2.0]))
    far = [-np.inf, -1e300, -0.0, 5e-324, 1.0, 1e300, np.inf]
    return rng.choice(far, shape), rng.choice(far, shape)


_SCALARS = (
    st.none()
    | st.booleans()
    | st.sampled_from(
        [0, 1, -1, 2.5, 2**63, -(2**63), 10**400, float("nan"), float("inf"), -float("inf"), "", "H", "nan"]
    )
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.binary(max_size=3)
    | st.complex_numbers(max_magnitude=2)
)
ARRAYS = st.sampled_from(
    [np.bool_, np.int8, np.int64, np.uint64, np.float16, np.float64, np.complex64, "U2", "S2", object]
)
JUNK = st.recursive(
    _SCALARS
    | ARRAYS.flatmap(
        lambda dtype: (
            arrays(dtype, st.tuples(st.integers(0, 3), st.integers(0, 3)), fill=st.nothing())
            if dtype is not object
            else st.just(np.array([[None, 1], ["a", ()]], object))
        )
    ),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(st.text(max_size=3) | st.integers(-2, 9), inner, max_size=3)
    ),
    max_leaves=8,
)
JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.sampled_from([0, -1, 1, 5, 2**31, 2**63, 10**30, 0.5, float("nan"), float("inf"), "0", "x"])
    | st.integers(-3, 40)
    | st.floats()
    | st.text(max_size=4),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=3) | st.integers(0, 40).map(str), inner, max_size=3)
    ),
    max_leaves=6,
)


def tried(make, *given, **options):
    """What is made, None where it is refused by a ValueError, which says something, and not too much."""
    try:
        return make(*given, **options)
    except ValueError as error:
        said = str(error)
    assert 5 < len(said) < 3000, said
    return None
