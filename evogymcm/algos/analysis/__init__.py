"""Analysis: scores over seeds, fronts of score and cost, time series of an episode, what voxels do with stiffness."""

from evogymcm._doors import door
from evogymcm.algos.analysis import statistics

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "pareto": ["pareto_front"],
        "recording": ["GroundContact", "Recording", "record_episode"],
        "signals": ["Signals", "Spectra", "TouchDown", "VoxelSignals", "analyse_signals"],
        "statistics": statistics.__all__,
    },
)
