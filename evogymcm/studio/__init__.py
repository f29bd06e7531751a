"""The studio: designs that are drawn, painted, watched and trained on a page in the browser. Needs `evogymcm[studio]`."""

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
