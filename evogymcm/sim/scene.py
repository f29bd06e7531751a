"""A scene: one robot in one world, as the tables that the kernels read.

Only what can move is state: the corners of the voxels that are not fixed. Fixed voxels, whether a whole terrain or the
posts of a soft bridge, are geometry: they are found through a grid of world cells, and stand in a `Terrain` that all
scenes of a `Scenery` share. The scenery's moving objects come first in a scene's tables and the robot last, so that a
scene of another robot is the same tables with another end.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from evogymcm.sim.constants import MISSING, Physics
from evogymcm.sim.contact_order import join_trees
from evogymcm.sim.parts import Fixed, PlacedObject, Sizes, object_tables, uses_of
from evogymcm.sim.tables import N_OBJECT_COLUMNS, Layout, Terrain
from evogymcm.sim.world import WorldObject

EDGE_RULES = ("mean_factor", "mean_stiffness")


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene's tables and its objects, robot first."""

    layout: Layout
    terrain: Terrain
    objects: tuple[PlacedObject, ...]

    def object(self, name: str) -> PlacedObject:
        """Returns the object called `name`; ValueError where there is none."""
        for placed in self.objects:
            if placed.name == name:
                return placed
        raise ValueError(f"object: got {name!r}, this world has {[o.name for o in self.objects]}")


def _joined(layouts: Sequence[Layout]) -> dict[str, np.ndarray]:
    """Returns the tables of several objects one after another; `groups` keeps no end."""
    offset, groups = 0, []
    for layout in layouts:
        groups.append(layout.groups[:-1] + offset)
        offset += int(layout.groups[-1])
    tables = {
        name: np.concatenate([getattr(layout, name) for layout in layouts])
        for name in Layout._fields
        if name != "groups"
    }
    return tables | {"groups": np.concatenate(groups)}


class Scenery:
    """The objects of a world other than the robot, of which each robot makes a `Scene`.

    Args:
        others: The objects in simulation order.
        edge_rule: "mean_factor" (k = mean of the owners' S times the edge's constant; the EvoGymCM paper's equation) or
            "mean_stiffness" (k = mean over owners of S times the owner's own type's constant, in every object; the
            reference code of the invariant setting).
        placed_at_reset: Objects whose place each reset may choose, for each world apart: all their points are state,
            also where they are fixed.
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
        self._parts: list[Layout] = []
        self._fixed: list[Fixed] = []
        self.objects: list[PlacedObject] = []
        self._before = Sizes()
        for number, source in enumerate(others, 1):
            is_placed = source.name in placed_at_reset
            layout, fixed, placed = object_tables(
                source, number, self._before, edge_rule, self._convergence, is_placed, None
            )
            self._parts.append(layout)
            self._fixed.append(fixed)
            self.objects.append(placed)
            self._before = Sizes(
                self._before.points + len(layout.initial) // 2,
                self._before.springs + len(layout.rest),
                self._before.cells + len(layout.surface),
                self._before.statics + len(fixed.static),
                self._before.fixed + len(fixed.surface),
            )

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
        tables = _joined([*self._parts, layout])
        tables["groups"] = np.append(tables["groups"], len(tables["pulls"]))
        objects = tables["objects"].reshape(-1, N_OBJECT_COLUMNS)
        tables["objects"] = np.roll(objects, 1, axis=0).ravel()
        n_cells = len(tables["surface"])
        fixed_corners = self.terrain.corners.reshape(-1, 4)
        corners = np.concatenate([tables["corners"].reshape(-1, 4), fixed_corners])
        numbers = np.concatenate([np.arange(n_cells), ~np.arange(len(fixed_corners))])
        points = np.where(corners >= 0, corners >> 1, MISSING)
        start, uses = uses_of(points, numbers, len(tables["initial"]) // 2)
        tables |= {"uses_start": start, "uses": uses.ravel()}
        of_fixed = [np.full(len(fixed.surface), k, np.int32) for k, fixed in enumerate(self._fixed, 1)]
        tables["cell_object"] = np.concatenate([tables["cell_object"], *of_fixed])
        every = (placed, *self.objects)
        numbered = [np.where(one.voxels >= 0, one.voxels, n_cells + ~one.voxels) for one in every]
        forest = join_trees([one.tree for one in every], numbered)
        tables |= {"node_start": forest.node_start, "children": forest.children.ravel(), "leaf": forest.leaf}
        tables |= {"node_place": forest.place, "node_voxel": forest.voxel}
        return Scene(Layout(**tables), self.terrain, every)
