"""The simulator: arrays in, arrays out. It knows no task and no torch."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "_pictures": ["load_prefab", "prefab_names", "world_names"],
        "constants": ["Physics"],
        "scene": ["Scenery"],
        "simulator": ["Objects", "Simulator"],
        "world": ["World", "WorldObject"],
    },
)
