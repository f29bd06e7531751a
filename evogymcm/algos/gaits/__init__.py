"""Open-loop gaits: waves of actuation that a search fits to a body, without a network."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "config": ["GaitConfig"],
        "search": ["FoundGaits", "search_gaits"],
        "stored": ["SavedGaits", "load_gaits", "save_gaits"],
        "wave": ["Waves"],
    },
)
