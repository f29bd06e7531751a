"""Analysis: scores over seeds, fronts of score and cost, shapes of designs, and what voxels do with stiffness."""

from evogymcm._doors import door
from evogymcm.algos.analysis import statistics

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "designs": ["Shape", "StiffnessField", "mean_stiffness", "measure_shape", "stiffness_contrast"],
        "pareto": ["pareto_front"],
        "recording": ["GroundContact", "Recording", "record_episode"],
        "signals": ["Signals", "Spectra", "TouchDown", "VoxelSignals", "analyse_signals", "anticipation"],
        "statistics": statistics.__all__,
    },
)
