"""Stored runs: the folder of a run, its record, its policies, and where it was made."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "folder": ["RunFiles", "RunFolder", "RunInUseError", "stop_on_interrupt"],
        "origin": ["find_origin", "usable_cores"],
        "policies": ["SavedPolicy", "load_policy"],
        "record": ["RunRecord"],
    },
)
