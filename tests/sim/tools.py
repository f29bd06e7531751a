"""What several tests of this folder share."""

import numpy as np

from evogymcm._grid import grid_from_rows
from evogymcm.sim.advance import advance
from evogymcm.sim.simulator import Simulator
from evogymcm.sim.springs import CONSTANT, FACTOR, GOAL, N_STATE_ROWS, OLD_X, VX, X
from evogymcm.sim.world import ROBOT, World, WorldObject

STANDARD = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"
SMALL = "HSV/R.H"


def grid_of(text):
    return grid_from_rows(text.split("/"))


def placed(text, world="Walker-v0", at=(2, 1), connections=None):
    """The objects of a world (a package's world by name, or a World) with a robot in it, in simulation order."""
    world = World.load(world) if isinstance(world, str) else world
    return world.place(WorldObject(ROBOT, grid_of(text), at, connections)).simulation_order()


def in_air(text, at=(4, 10), connections=None):
    """A robot alone."""
    return placed(text, World(30, 30), at, connections)


def all_state(sim, world=0):
    """Everything that the kernels carry from step to step in one world, to be compared bit for bit."""
    block, lane = sim.lane_of[world]
    state = sim.blocks[block].state
    rows = [state.points[:N_STATE_ROWS, :, lane], state.springs[[CONSTANT, FACTOR, GOAL], :, lane]]
    return np.concatenate([values.ravel() for values in rows])


def place_points(sim, x, v, old, world=0):
    """Sets positions, velocities and former positions, (points of all objects, 2), where points can move."""
    block, lane = sim.lane_of[world]
    block = sim.blocks[block]
    start = 0
    for placed_object in block.scene.objects:
        numbers = placed_object.points
        moving = np.flatnonzero(numbers < block.scene.n_points)
        for row, values in ((X, x), (VX, v), (OLD_X, old)):
            block.state.points[row : row + 2, numbers[moving], lane] = values[start + moving].T
        start += len(numbers)


def all_points(sim, world=0):
    """Positions and velocities of the points of all objects, (points, 2) each."""
    block = sim.blocks[sim.lane_of[world][0]]
    names = [o.name for o in block.scene.objects]
    x = np.concatenate([sim.positions(name, world) for name in names], axis=1).T
    v = np.concatenate([sim.velocities(name, world) for name in names], axis=1).T
    return x, v


def run_substeps(sim, n_substeps=1, actuation=None):
    """Advances every world by some substeps, all actuators neutral by default; returns which became unstable."""
    if actuation is None:
        actuation = np.ones((sim.n_worlds, sim.n_cells))
    unstable = np.zeros(sim.n_worlds, bool)
    for block in sim.blocks:
        used = block.worlds >= 0
        keep = np.empty((0, sim.n_cells))  # the stiffness
        physics = sim.physics.values()
        failed = advance(block.layout, physics, block.state, block.worlds, actuation, keep, n_substeps)
        assert failed >= 0  # no list was too short
        unstable[block.worlds[used]] = np.unpackbits(np.array([failed], np.uint8), bitorder="little")[used]
    return unstable


def simulator(*worlds, **options):
    return Simulator(worlds, **{"num_threads": 1} | options)
