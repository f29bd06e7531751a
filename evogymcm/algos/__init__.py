"""Learning: a policy shared by all voxels, PPO, evaluation, run folders."""

from evogymcm.algos.actor import Actor, MLPActor, VoxelActor, load_actor, make_actor
from evogymcm.algos.body_ppo import BodyPPOConfig
from evogymcm.algos.critic import MLPCritic, VoxelCritic, make_critic
from evogymcm.algos.distributions import MaskedClippedNormal, VoxelActions
from evogymcm.algos.evaluate import Evaluation, evaluate
from evogymcm.algos.memory import keep_freed_memory
from evogymcm.algos.ppo import PPOConfig, PPOLearner
from evogymcm.algos.runs import RunFolder, RunInUseError, stop_on_interrupt
from evogymcm.algos.sharing import PerDesign, by_design, by_world, stack_states, take_state
from evogymcm.algos.trainer import EnvFactory, Trainer
from evogymcm.algos.training import Progress, TrainResult, train

__all__ = [
    "Actor",
    "BodyPPOConfig",
    "EnvFactory",
    "Evaluation",
    "MLPActor",
    "MLPCritic",
    "MaskedClippedNormal",
    "PPOConfig",
    "PPOLearner",
    "PerDesign",
    "Progress",
    "RunFolder",
    "RunInUseError",
    "TrainResult",
    "Trainer",
    "VoxelActions",
    "VoxelActor",
    "VoxelCritic",
    "by_design",
    "by_world",
    "evaluate",
    "keep_freed_memory",
    "load_actor",
    "make_actor",
    "make_critic",
    "stack_states",
    "stop_on_interrupt",
    "take_state",
    "train",
]
