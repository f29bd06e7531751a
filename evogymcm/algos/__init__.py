"""Learning: a policy shared by all voxels, PPO, evaluation, run folders."""

from evogymcm.algos.actor import VoxelActor, make_actor
from evogymcm.algos.critic import VoxelCritic, make_critic
from evogymcm.algos.distributions import MaskedSquashedNormal, VoxelActions
from evogymcm.algos.evaluate import Evaluation, evaluate
from evogymcm.algos.ppo import PPOConfig, PPOLearner
from evogymcm.algos.runs import RunFolder, stop_on_interrupt
from evogymcm.algos.training import EnvFactory, Progress, Trainer, TrainResult, train

__all__ = [
    "EnvFactory",
    "Evaluation",
    "MaskedSquashedNormal",
    "PPOConfig",
    "PPOLearner",
    "Progress",
    "RunFolder",
    "TrainResult",
    "Trainer",
    "VoxelActions",
    "VoxelActor",
    "VoxelCritic",
    "evaluate",
    "make_actor",
    "make_critic",
    "stop_on_interrupt",
    "train",
]
