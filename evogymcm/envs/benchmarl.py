"""A population of bodies as a task of BenchMARL."""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any, Unpack

from torchrl.data import Composite
from torchrl.envs import EnvBase

from evogymcm.envs.dealing import BodySpec, as_bodies
from evogymcm.envs.flat_population import FlatPopulationEnv
from evogymcm.envs.options import EngineOptions, complete
from evogymcm.envs.task import Task
from evogymcm.envs.tasks import as_task

_missing: ImportError | None = None
try:
    from benchmarl.environments import TaskClass
except ImportError as error:  # the module can be read without, as all others
    TaskClass, _missing = object, error


class BenchMARLTask(TaskClass):
    """Many bodies that learn one task: BenchMARL's agents, in the group `bodies`, each alone in its own world.

    BenchMARL's `share_policy_params` says whether they have one policy. All environments that it asks for at once are
    worlds of one simulator; an episode is one of the whole population, see `FlatPopulationEnv`.

    Args:
        task: A task or its id.
        bodies: The bodies.
        options: material, stiffness, edge_rule, physics, num_threads, grid_shape and work_weight, as all take them: see
            `EngineOptions`. BenchMARL gives the seed.

    Raises:
        ImportError: benchmarl is not installed.
        ValueError: For a bad body or material; for other bad arguments when environments are made.
    """

    def __init__(
        self, task: str | Task, bodies: BodySpec | Sequence[BodySpec], **options: Unpack[EngineOptions]
    ) -> None:
        if _missing is not None:
            raise ImportError("BenchMARLTask needs benchmarl: pip install evogymcm[benchmarl]") from _missing
        if "seed" in options:
            raise ValueError("seed: BenchMARL gives it, as `Experiment(seed=...)`")
        complete(options)
        super().__init__(as_task(task).id, {"task": task, "bodies": as_bodies(bodies)} | options)

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Returns what makes an environment of so many copies of the population."""
        return lambda: FlatPopulationEnv(copies=num_envs, seed=seed, device=device, **self.config)

    def supports_continuous_actions(self) -> bool:
        """Actions are numbers."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Actions are numbers."""
        return False

    def has_render(self, env: EnvBase) -> bool:
        """Whether there are pictures: with pygame, which the extra `render` brings."""
        return find_spec("pygame") is not None

    def max_steps(self, env: EnvBase) -> int:
        """Returns the task's time limit."""
        return as_task(self.config["task"]).time_limit

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """Returns the one group, `bodies`."""
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        """Returns what each body sees."""
        return env.full_observation_spec_unbatched.clone()

    def action_spec(self, env: EnvBase) -> Composite:
        """Returns what each body does."""
        return env.full_action_spec_unbatched

    def info_spec(self, env: EnvBase) -> None:
        """There is none."""

    def state_spec(self, env: EnvBase) -> None:
        """There is none: a critic that sees everything gets the observations of all bodies."""

    def action_mask_spec(self, env: EnvBase) -> None:
        """There is none."""

    @staticmethod
    def env_name() -> str:
        """Returns the name of this library."""
        return "evogymcm"
