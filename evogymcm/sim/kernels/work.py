"""The work that commands do on a robot: what a change of actuation or stiffness adds to the energy of its springs.

A spring's rest length is formed anew in every substep, and yet its forces follow a potential: along a way on which its
length becomes d + x from d, a spring of constant k does the work -k (c (d - goal) x + x^2 / 2), with the convergence c.
That is what the potential c k (d - goal)^2 / 2 loses, less (1 - c) k x^2 / 2, which is never negative: damping. So all
energy that comes in by the springs comes with changes of k and goal, at the beginning of an env-step (docs/work.md).
"""

import math
from typing import NamedTuple

import numpy as np

from evogymcm.sim.constants import PhysicsValues
from evogymcm.sim.kernels._jit import kernel
from evogymcm.sim.kernels.advance import Storage, set_constants, set_goals
from evogymcm.sim.kernels.springs import slot_of
from evogymcm.sim.tables import layout_of, part

CONVERGENCE = PhysicsValues._fields.index("convergence")
N_SCRATCH = 6  # numbers a spring
N_WORK = 4


class Commands(NamedTuple):
    """What actions have set, for each cell of N worlds."""

    actuation: np.ndarray  # (N, V) target lengths relative to rest
    stiffness: np.ndarray  # (N, V) stiffness factors


@kernel
def command_work(
    storage: Storage, worlds: np.ndarray, before: Commands, after: Commands, scratch: np.ndarray, work: np.ndarray
) -> None:
    """Sets the work of a change of commands in worlds.

    Where actuation and stiffness change together, each is given the mean of its work before and after the other.

    Args:
        storage: All worlds, as they are when the commands change.
        worlds: (m,) those in which they change.
        before: The commands until then.
        after: The commands from then on.
        scratch: Memory for N_SCRATCH numbers of each spring of the largest world.
        work: (N, N_WORK) receives what actuation and what stiffness supply, the sums over springs of what is above
            zero; and their net work, the sums over all springs.
    """
    size = scratch.shape[0] // N_SCRATCH
    half = 0.5 * storage.physics[CONVERGENCE]
    for w in worlds:
        design = storage.design_of[w, 0]
        layout = layout_of(storage.ints[design], storage.floats[design])
        xy, n = part(storage.state[w], 0, layout.initial.shape[0]), layout.rest.shape[0]
        constant, factor, goal = part(scratch, 0, n), part(scratch, size, n), part(scratch, 2 * size, n)
        next_constant, next_factor = part(scratch, 3 * size, n), part(scratch, 4 * size, n)
        next_goal = part(scratch, 5 * size, n)
        for s in range(n):
            constant[s] = next_constant[s] = layout.constants[s]
            factor[s] = next_factor[s] = 1.0
            goal[s] = next_goal[s] = layout.rest[s]
        set_goals(layout, goal, before.actuation[w])
        set_goals(layout, next_goal, after.actuation[w])
        set_constants(layout, constant, factor, before.stiffness[w])
        set_constants(layout, next_constant, next_factor, after.stiffness[w])
        for column in range(N_WORK):
            work[w, column] = 0.0
        for i in range(0, layout.owned.shape[0], 3):
            s = layout.owned[i]
            end = 2 * (s & ~7) + (slot_of(s) & 7)
            a, b = layout.ends[end], layout.ends[end + 8]
            dx, dy = xy[a] - xy[b], xy[a + 1] - xy[b + 1]
            length = math.sqrt(dx * dx + dy * dy)
            was, now = (length - goal[s]) ** 2, (length - next_goal[s]) ** 2
            k, next_k = constant[s] * factor[s], next_constant[s] * next_factor[s]
            by_actuation = half * (k + next_k) / 2.0 * (now - was)
            by_stiffness = half * (next_k - k) * (was + now) / 2.0
            work[w, 0] += max(by_actuation, 0.0)
            work[w, 1] += max(by_stiffness, 0.0)
            work[w, 2] += by_actuation
            work[w, 3] += by_stiffness
