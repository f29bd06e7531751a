"""Roll-outs of the reference simulators, replayed (tests/data/README.md)."""

import numpy as np
import pytest

from evogymcm.sim.simulator import Simulator
from evogymcm.sim.world import ROBOT, World, WorldObject
from tests.golden import DATA, SAME_LIBRARY

RECORDS = {path.stem: path for path in sorted((DATA / "golden").glob("*.npz"))}
EARLY, EARLY_TOLERANCE = 30, 1e-9  # env-steps and metres, where the C library is not the recorder's


def objects_of(record):
    def build(name, grid, origin):
        key = "connections" if name == ROBOT and record["world"] else f"connections__{name}"
        return WorldObject(name, grid, tuple(origin), record.get(key))

    if record["world"]:
        return World.load(str(record["world"])).place(build(ROBOT, record["robot"], record["spawn"])).simulation_order()
    return tuple(build(str(n), record[f"grid__{n}"], record[f"xy__{n}"]) for n in record["objects"])


def replay(record):
    """Yields after every env-step its number, the simulator, and whether it was unstable; begins with 0."""
    setting = str(record["setting"])
    sim = Simulator([objects_of(record)], "mean_stiffness" if setting == "I" else "mean_factor", num_threads=1)
    if setting == "I" and "stiffness" in record:
        sim.set_stiffness(record["stiffness"].astype(float)[None])
    if "start_offset" in record:
        sim.move(ROBOT, tuple(record["start_offset"]), 0)
    actuation = np.ones((1, sim.n_cells))
    yield 0, sim, False
    for step, numbers in enumerate(record["actuation"]):
        actuation[0, record["actuators"]] = numbers
        stiffness = record["stiffness"][step].astype(float)[None] if setting == "R" and "stiffness" in record else None
        yield step + 1, sim, bool(sim.step(actuation, stiffness)[0])


@pytest.mark.parametrize("name", RECORDS)
def test_every_bit_is_the_references(name):
    with np.load(RECORDS[name]) as file:
        record = dict(file)
    names = [key.removeprefix("pos__") for key in record if key.startswith("pos__")]
    at, vel_at = ({int(k): i for i, k in enumerate(record[key])} for key in ("frames", "vel_frames"))
    unstable, compared = False, 0
    for step, sim, failed in replay(record):
        unstable |= failed
        if step > EARLY and not SAME_LIBRARY:
            continue
        for obj in names:
            if step in at:
                expected, compared = record[f"pos__{obj}"][at[step]], compared + 1
                error = np.abs(sim.positions(obj) - expected).max()
                assert error <= (0.0 if SAME_LIBRARY else EARLY_TOLERANCE), f"step {step}"
            if step in vel_at:
                error = np.abs(sim.velocities(obj) - record[f"vel__{obj}"][vel_at[step]]).max()
                assert error <= (0.0 if SAME_LIBRARY else 1e-5), f"step {step}"
    assert unstable == bool(record["unstable"])
    assert compared >= 2


def test_every_setting_and_paper_task_is_there():
    for setting in ("base", "R", "I"):
        assert {f"{setting}_{task}" for task in ("walker", "bridge", "down", "cave", "amax", "amin")} <= set(RECORDS)


def test_the_two_edge_rules_differ_where_materials_meet():
    """The invariant simulator's own rule is needed for its records; the paper's equation leaves them at once."""
    with np.load(RECORDS["micro_mixed_I_ones"]) as file:
        record = dict(file)
    sim = Simulator([objects_of(record)], "mean_factor", num_threads=1)
    actuation = np.ones((1, sim.n_cells))
    for numbers in record["actuation"][:5]:
        actuation[0, record["actuators"]] = numbers
        sim.step(actuation)
    error = np.abs(sim.positions() - record["pos__robot"][record["frames"].tolist().index(5)]).max()
    assert error > 1e-4
