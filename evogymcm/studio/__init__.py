"""The studio: a page to draw designs, paint, watch and train them. Its server needs `evogymcm[studio]`."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "drawing": ["Drawing"],
        "player": ["Player"],
        "server": ["serve"],
        "terrain": ["Terrain"],
    },
)
