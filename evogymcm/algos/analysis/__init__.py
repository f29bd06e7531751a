"""Analysis: scores over seeds, time series of an episode, and what voxels do with their stiffness in it."""

from evogymcm._doors import door
from evogymcm.algos.analysis import statistics

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "recording": ["GroundContact", "Recording", "record_episode"],
        "signals": ["Signals", "Spectra", "TouchDown", "VoxelSignals", "analyse_signals"],
        "statistics": statistics.__all__,
    },
)
