"""What several tests of this folder share."""

from typing import NamedTuple

import numpy as np

from evogymcm._grid import grid_from_rows
from evogymcm.sim.kernels.vectors import LANE_SLOTS
from evogymcm.sim.simulator import Simulator
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
    """Everything that is carried from step to step in one world, to be compared bit for bit."""
    return sim.state()[1 + world]  # after the offsets


def place_points(sim, x, v, old, world=0):
    """Sets positions, velocities and former positions, (points of all objects, 2), where points can move."""
    sim.set_points(x.T, v.T, old.T, world)


def all_points(sim, world=0):
    """Positions and velocities of the points of all objects, (points, 2) each."""
    velocities = [sim.velocities(placed.name, world) for placed in sim.objects(world)]
    return sim.points(world).T, np.concatenate(velocities, axis=1).T


class Springs(NamedTuple):
    """Springs of a world in its tables' order; points are numbered as in `all_points`."""

    ends: np.ndarray  # (S, 2)
    rest: np.ndarray
    constants: np.ndarray  # in force
    rigid: np.ndarray  # (R, 2) ends of rigid voxels' edges, as they are corrected


def springs_of(sim, world=0):
    layout, (constants, factors, _) = sim._scene(world).layout, sim._springs(world)
    point_at = {place: p for p, place in enumerate(sim._all_places(world).tolist())}
    number = np.vectorize(point_at.get, otypes=[int])
    is_real = ~np.isnan(layout.rest)
    ends = layout.ends.reshape(-1, 2, 8)[:, :, list(LANE_SLOTS)].transpose(0, 2, 1).reshape(-1, 2)[is_real]
    rigid = number(layout.rigid.reshape(-1, 2)) if len(layout.rigid) else np.zeros((0, 2), int)
    return Springs(number(ends), layout.rest[is_real], (constants * factors)[is_real], rigid)


def forget_room(sim):
    """Leaves hardly any room for candidates and contacts, so that a step has to make more."""
    sim._room = sim._room._replace(candidates=1, contacts=1)
    sim._scratches = []


def room_of(sim):
    """How many candidates and contacts the first thread has room for."""
    return sim._scratches[0].ints[6:8].tolist()


def run_substeps(sim, n_substeps=1, actuation=None):
    """Advances every world by some substeps, all actuators neutral by default; returns which became unstable."""
    if actuation is None:
        actuation = np.ones((sim.n_worlds, sim.n_cells))
    return sim.substeps(n_substeps, actuation)


def simulator(*worlds, **options):
    return Simulator(worlds, **{"num_threads": 1} | options)
