"""What a run leaves behind: its folder."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(__name__, {"folder": ["RunFolder", "RunInUseError", "stop_on_interrupt"]})
