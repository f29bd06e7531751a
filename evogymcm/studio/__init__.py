"""The studio: designs that are drawn, painted, watched and trained on a page in the browser."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "drawing": ["Drawing"],
        "store": ["Store"],
        "terrain": ["Terrain"],
    },
)
