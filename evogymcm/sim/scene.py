"""A scene: one robot in one world, as the tables that the kernels read.

Only what can move is state: the corners of the voxels that are not fixed. Fixed voxels, whether a whole terrain or the
posts of a soft bridge, are geometry: they are found through a grid of world cells, and stand in a `Terrain` that all
scenes of a `Scenery` share. The scenery's moving objects come first in a scene's tables and the robot last, so that a
scene of another robot is the same tables with another end.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np

from evogymcm._settings import EdgeRule
from evogymcm.sim.constants import MISSING, Physics
from evogymcm.sim.kernels.contact_order import join_trees, put_first
from evogymcm.sim.parts import Fixed, PlacedObject, Sizes, object_tables, uses_of
from evogymcm.sim.tables import Layout, Terrain
from evogymcm.sim.world import WorldObject

EDGE_RULES = get_args(EdgeRule)


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene's tables and its objects, robot first."""

    layout: Layout
    terrain: Terrain
    objects: tuple[PlacedObject, ...]

    @property
    def n_numbers(self) -> int:
        """How many numbers the state of a world takes, see `Storage.state`."""
        return 3 * len(self.layout.initial) + 3 * len(self.layout.rest)

    def object(self, name: str) -> PlacedObject:
        """Returns the object called `name`; ValueError where there is none."""
        for placed in self.objects:
            if placed.name == name:
                return placed
        raise ValueError(f"object: got {name!r}, this world has {[o.name for o in self.objects]}")


def _joined(one: Layout, other: Layout) -> Layout:
    """Returns the tables of objects one after another; to join with nothing is left out, as it takes as long."""
    groups = np.concatenate([one.groups[:-1], other.groups + one.groups[-1]])
    parts = zip(one, other, strict=True)
    return Layout(*[b if not a.size else np.concatenate((a, b)) for a, b in parts])._replace(groups=groups)


class Scenery:
    """The objects of a world other than the robot; with a robot they make a `Scene`.

    Args:
        others: The objects in simulation order.
        edge_rule: "mean_factor" (k = mean of the owners' S times the edge's constant; the EvoGymCM paper's equation) or
            "mean_stiffness" (k = mean over owners of S times the owner's own type's constant, in every object; the
            reference code of the invariant setting).
        placed_at_reset: Objects that a reset may move, in each world separately: all their points are state, even fixed
            ones.
        physics: Constants.

    Raises:
        ValueError: For an unknown edge rule.
    """

    def __init__(
        self,
        others: Sequence[WorldObject],
        edge_rule: str = "mean_factor",
        placed_at_reset: Sequence[str] = (),
        physics: Physics | None = None,
    ) -> None:
        if edge_rule not in EDGE_RULES:
            raise ValueError(f"edge_rule: got {edge_rule!r}, allowed are {EDGE_RULES}")
        self._edge_rule, self._convergence = edge_rule, (physics or Physics()).convergence
        self._layout: Layout | None = None
        self._fixed: list[Fixed] = []
        self.objects: list[PlacedObject] = []
        self._before = Sizes()
        for number, source in enumerate(others, 1):
            is_placed = source.name in placed_at_reset
            layout, fixed, placed = object_tables(
                source, number, self._before, edge_rule, self._convergence, is_placed, None
            )
            self._layout = layout if self._layout is None else _joined(self._layout, layout)
            self._fixed.append(fixed)
            self.objects.append(placed)
            self._before = Sizes(
                self._before.points + len(layout.initial) // 2,
                self._before.springs + len(layout.rest),
                self._before.cells + len(layout.surface),
                self._before.statics + len(fixed.static),
                self._before.fixed + len(fixed.surface),
            )
        n_cells = self._before.cells
        numbered = [np.where(one.voxels >= 0, one.voxels, n_cells + ~one.voxels) for one in self.objects]
        self._forest = join_trees([one.tree for one in self.objects], numbered)
        of_fixed = [np.full(len(fixed.surface), number, np.int32) for number, fixed in enumerate(self._fixed, 1)]
        self._fixed_object = np.concatenate([np.zeros(0, np.int32), *of_fixed])

    @cached_property
    def terrain(self) -> Terrain:
        """The fixed voxels, shared by all scenes."""
        empty = np.zeros((0, 2)), np.zeros((0, 4)), np.zeros((0, 8)), np.zeros(0), np.zeros((0, 2))
        parts = [np.concatenate(values) for values in zip(empty, *self._fixed, strict=True)]
        static, corners, sides, surface, cells = parts[0], *(values.astype(np.int32) for values in parts[1:])
        start, uses = uses_of(~corners >> 1, ~np.arange(len(corners)), len(static))
        height, width = (cells.max(0) + 2) if len(cells) else (1, 1)
        cell_at = np.full((height, width), MISSING, np.int32)
        cell_at[cells[:, 0], cells[:, 1]] = np.arange(len(cells))
        return Terrain(
            static=static.ravel(),
            corners=corners.ravel(),
            sides=sides.ravel(),
            surface=surface,
            uses_start=start,
            uses=uses.ravel(),
            cell_at=cell_at.ravel(),
            extent=np.array(cell_at.shape, np.int32),
            points_start=np.cumsum([0, 0, *(len(placed.places) for placed in self.objects)]).astype(np.int32),
            points=np.concatenate([np.zeros(0, np.int32), *(placed.places for placed in self.objects)]),
        )

    def scene(self, robot: WorldObject, grid_shape: tuple[int, int]) -> Scene:
        """Returns the scene with a robot whose actions come on a padded grid of `grid_shape` (rows, columns)."""
        layout, _, placed = object_tables(
            robot, 0, self._before, self._edge_rule, self._convergence, False, grid_shape[1]
        )
        tables = (layout if self._layout is None else _joined(self._layout, layout))._asdict()
        if self._layout is not None:
            tables["objects"] = np.concatenate([layout.objects, self._layout.objects])  # the robot first
        n_cells, fixed_corners = len(tables["surface"]), self.terrain.corners
        corners = np.concatenate([tables["corners"], fixed_corners]).reshape(-1, 4)
        numbers = np.concatenate([np.arange(n_cells), ~np.arange(len(fixed_corners) // 4)])
        points = np.where(corners >= 0, corners >> 1, MISSING)
        start, uses = uses_of(points, numbers, len(tables["initial"]) // 2)
        tables |= {"uses_start": start, "uses": uses.ravel()}
        tables["cell_object"] = np.concatenate([tables["cell_object"], self._fixed_object])
        n_before = self._before.cells
        forest = put_first(placed.tree, placed.voxels - n_before, self._forest, n_before)
        tables |= {"node_start": forest.node_start, "children": forest.children.ravel(), "leaf": forest.leaf}
        tables |= {"node_place": forest.place, "node_voxel": forest.voxel}
        return Scene(Layout(**tables), self.terrain, (placed, *self.objects))
