"""The engine behind whatever holds worlds, so that functions on worlds take environments and engines alike."""

from evogymcm.envs.core import TaskEngine


def engine_of(worlds: object) -> TaskEngine:
    """Returns the engine of an environment of this library, whatever wraps it, or the engine that is given.

    Raises:
        ValueError: There is none.
    """
    found = worlds if isinstance(worlds, TaskEngine) else getattr(getattr(worlds, "unwrapped", worlds), "engine", None)
    if not isinstance(found, TaskEngine):
        raise ValueError(f"env: got {type(worlds).__name__}, expected a TaskEngine or an environment of this library")
    return found
