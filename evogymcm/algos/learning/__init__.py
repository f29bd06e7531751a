"""Learning: a policy shared by all voxels, PPO, evaluation."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "actor": ["Actor", "MLPActor", "VoxelActor", "load_actor", "make_actor"],
        "config": ["PPOConfig", "TrainConfig"],
        "critic": ["MLPCritic", "VoxelCritic", "make_critic"],
        "distributions": ["MaskedClippedNormal", "VoxelActions"],
        "env": ["EnvFactory", "TrainingEnv"],
        "evaluation": ["Evaluation", "evaluate"],
        "loop": ["Progress", "TrainResult"],
        "memory": ["keep_freed_memory"],
        "playing": ["Episodes", "play"],
        "ppo": ["PPOLearner"],
        "stacking": ["PerDesign", "by_design", "by_world", "stack_states", "take_state"],
        "trainer": ["Trainer"],
        "training": ["train"],
    },
)
