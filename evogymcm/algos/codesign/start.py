"""What a run of co-design begins with: its search over bodies, its environments, and whether it can begin at all."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from evogymcm._extras import load_cma
from evogymcm.algos.codesign.body_search import DesignSearch
from evogymcm.algos.codesign.config import CodesignConfig
from evogymcm.algos.codesign.genetic import GeneticAlgorithm
from evogymcm.algos.codesign.map_elites import MapElites
from evogymcm.algos.codesign.random_search import RandomSearch
from evogymcm.algos.learning.initial import exploring, find_initial
from evogymcm.algos.learning.transfer import carried_over
from evogymcm.body import H_ACT, Body
from evogymcm.envs import SoftRobotEnv
from evogymcm.envs.tasks import as_task

_METHODS: dict[str, type[DesignSearch]] = {"ga": GeneticAlgorithm, "random": RandomSearch, "qd": MapElites}


def make_body_search(config: CodesignConfig) -> DesignSearch:
    """Returns the search over bodies, before its first generation."""
    options: dict[str, Any] = {name: getattr(config, name) for name in ("seed", "mutation_rate", "attempts", "weights")}
    if config.method == "ga":
        options["age_protection"] = config.age_protection
    options["carries_stiffness"] = config.search is not None and config.method != "random"
    return _METHODS[config.method](config.shape, config.budget, config.population, **options)


def env_maker(config: CodesignConfig) -> partial[SoftRobotEnv]:
    """Returns what makes the run's environments, see `train_designs`, in a process that has not its task too."""
    names = ("material", "edge_rule", "work_weight", "num_threads")
    options: dict[str, Any] = {name: getattr(config, name) for name in names}
    return partial(SoftRobotEnv, as_task(config.task), **options)


def check_start(config: CodesignConfig) -> None:
    """Makes sure that a run can start: raises what would be raised only in the first generation.

    Raises:
        ValueError: There is no such task, or a body that fills the shape does not fit into its world, or policies
            cannot begin as they should.
        ImportError: The package of the method or of the search's proposals is missing.
    """
    make_body_search(config)
    if config.search and config.search.proposal == "cma":
        load_cma()
    first_policy(config)


def first_policy(config: CodesignConfig) -> tuple[str, dict[str, Any] | None]:
    """Returns what policies begin with, see `RunRecord.initial`, and that policy for this task, None for fresh ones.

    Raises:
        ValueError: See `check_start`.
    """
    env = env_maker(config)(bodies=[Body(np.full(config.shape, H_ACT))], num_worlds=1, seed=0)
    try:
        word, saved = find_initial(config.initial, config.task, config.material, config.ppo)
        if saved is None:
            return word, None
        if saved.state["form"].get("copies") is not None:
            raise ValueError(f"initial: {saved.path} holds policies of several bodies, expected one policy")
        policy = carried_over(exploring(saved.state, config.ppo.initial_std), env)
        replace(saved, state=policy).module(env)  # does it act there?
        return word, policy
    finally:
        env.close(raise_if_closed=False)
