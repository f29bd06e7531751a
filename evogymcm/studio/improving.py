"""Better stiffness for a body that moves already: the library's material search, in a process of its own."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from evogymcm._settings import EdgeRule, check_count
from evogymcm.algos.codesign.config import SearchConfig
from evogymcm.algos.runs.folder import RunFolder
from evogymcm.algos.runs.origin import usable_cores
from evogymcm.body import Body, as_body, check_stiffness
from evogymcm.envs.dealing import BodySpec
from evogymcm.envs.tasks import as_task
from evogymcm.studio.driving import SINE, Driver
from evogymcm.studio.processes import Job, Tell

if TYPE_CHECKING:
    from evogymcm.algos.codesign.material_search import MaterialSearch

SEARCH = SearchConfig(rounds=30, candidates=4, acceptance="paper")
_POLICY, _STATE = "policy", "search.json"


@dataclass(frozen=True)
class ImprovementConfig:
    """Everything that an improvement depends on besides the weights of its policy.

    Attributes:
        task: Id of the task, or the file of a world to walk in.
        body: Rows of voxels.
        stiffness: (rows, columns) the field to begin with.
        policy: "sine", or "policy" for the one in the folder.
        edge_rule: How stiffness acts on shared edges; that of the policy's training.
        search: Settings of the search.
        seed: Of its draws.
    """

    task: str
    body: str
    stiffness: tuple[tuple[float, ...], ...]
    policy: str = SINE
    edge_rule: EdgeRule = "mean_factor"
    search: SearchConfig = field(default_factory=SearchConfig)
    seed: int = 0

    @property
    def design(self) -> tuple[Body, np.ndarray]:
        """The body and its field."""
        body = Body(self.body)
        return body, check_stiffness(self.stiffness, body)


class MaterialImprovement(Job):
    """Searches a better stiffness field for a body under what moves it, in a process of its own.

    Each round tries some fields near the best one, and takes the best of them where its score is larger: the score
    never falls. Body and policy stay as they are.

    Args:
        folder: Of the run; made when it starts, with a copy of the policy.
        body: Anything that `as_body` takes.
        stiffness: (rows, columns) in [0.5, 2], the field to begin with; None for 1.
        task: Id of the task, or a world's file, of which the folder gets a copy.
        policy: "sine" (the gait), or a policy of the invariant setting that moves this body: "baseline", the folder of
            a run, one of its files, or a `SavedPolicy`.
        search: Settings; by default 30 rounds of 4 fields, where any gain counts.
        seed: Of its draws.

    Raises:
        ValueError: The design is not valid, or there is no such policy, or it sets stiffness itself.
    """

    kind = "material"
    _driver: Driver | None = None

    def __init__(
        self,
        folder: str | os.PathLike[str],
        body: BodySpec,
        stiffness: Any = None,
        task: str | os.PathLike[str] = "Walker-v0",
        policy: Any = SINE,
        search: SearchConfig | None = None,
        *,
        seed: int = 0,
    ) -> None:
        body = as_body(body)
        rows = tuple(map(tuple, check_stiffness(stiffness, body).tolist()))
        self._driver = Driver(policy, as_task(task), "invariant")
        saved = self._driver.saved
        if saved is None and policy != SINE:
            raise ValueError(f"policy: got {policy!r}, expected {SINE!r} or a policy of a run")
        config = ImprovementConfig(
            self._own(folder, task),
            body.text,
            rows,
            SINE if saved is None else _POLICY,
            "mean_factor" if saved is None else saved.edge_rule,  # type: ignore[arg-type]
            SEARCH if search is None else search,
            check_count("seed", seed, 0),
        )
        super().__init__(folder, config)

    @classmethod
    def read_config(cls, saved: Mapping[str, Any]) -> ImprovementConfig:
        """Returns the settings of an improvement."""
        rows = tuple(map(tuple, saved["stiffness"]))
        return ImprovementConfig(**{**saved, "stiffness": rows, "search": SearchConfig(**saved["search"])})

    def check(self) -> None:
        """Raises a ValueError where the design does not fit into the task, or the policy cannot move it."""
        if self._driver is not None:
            body, field = self.config.design
            self._driver.make(body, field, self.config.seed)

    def _prepare(self, run: RunFolder) -> None:
        super()._prepare(run)
        if self._driver is not None and self._driver.saved is not None:
            run.save(_POLICY, {name: self._driver.saved.state[name] for name in ("form", "actor", "critic")})

    def work(self, run: RunFolder, should_stop: Callable[[], bool], tell: Tell) -> bool:
        """Searches round by round, from the last one that the folder has."""
        from evogymcm.algos.codesign.design import Design, Individual
        from evogymcm.algos.codesign.material_search import MaterialSearch

        config, state = self.config, run.read_json(_STATE)
        scores = _GaitScores(config) if config.policy == SINE else _PolicyScores(config, run)
        body, field = config.design
        if state:
            fitness, steps = state["search"]["settings"]["individuals"][0]["fitness"], state["env_steps"]
        else:
            fitness, steps = scores.first(body, field)
        design = Individual(0, Design(body, field), fitness=fitness)
        search = MaterialSearch([design], seed=config.seed, **asdict(config.search))
        if state:
            search.load_state_dict(state["search"])
        run.keep_rows(search.n_rounds + 1 if state else 0)
        while True:
            best = search.best
            if search.n_rounds == len(run.rows()):
                run.append({"round": search.n_rounds, "env_steps": steps, "score": float(best.scores[0])})
            told = {"search": search.state_dict(), "env_steps": steps, "stiffness": best.fields[0].tolist()}
            run.write_json(_STATE, told)
            if search.is_finished or should_stop():
                return search.is_finished
            worth, spent = scores.of(search)
            search.tell(worth)
            steps += spent

    @property
    def has_finished(self) -> bool:
        """Whether all rounds are over."""
        return len(self.files.rows()) > self.config.search.rounds

    def progress(self, told: Mapping[str, Any]) -> dict[str, Any]:
        """Returns how far it is.

        | key | what |
        | --- | --- |
        | `round`, `total` | rounds that are over, and all |
        | `env_steps` | simulated so far |
        | `curve` | (round, best score) |
        | `score`, `gain` | the best score, None at first, and how much larger it is than at the beginning |
        | `stiffness` | (rows, columns) the best field, as lists |
        """
        rows, state = self.files.rows(), self.files.read_json(_STATE)
        scores = [row["score"] for row in rows]
        return {
            "round": max(0, len(rows) - 1),
            "total": self.config.search.rounds,
            "env_steps": rows[-1]["env_steps"] if rows else 0,
            "curve": [(row["round"], row["score"]) for row in rows],
            "score": scores[-1] if scores else None,
            "gain": scores[-1] - scores[0] if scores else 0.0,
            "stiffness": state.get("stiffness", [list(row) for row in self.config.stiffness]),
        }


class _PolicyScores:
    """Scores of fields under the policy in a folder, and the env-steps that they took."""

    def __init__(self, config: ImprovementConfig, run: RunFolder) -> None:
        from evogymcm.envs import SoftRobotEnv

        policy = run.load(_POLICY)
        if policy is None:
            raise ValueError(f"policy: {run.path} has lost its {_POLICY}.pt")
        options: dict[str, Any] = {"material": "invariant", "edge_rule": config.edge_rule}
        self._make_env = partial(SoftRobotEnv, config.task, num_threads=_threads(), **options)
        self._policies = [policy]

    def first(self, body: Body, field: np.ndarray) -> tuple[float, int]:
        from evogymcm.algos.codesign.design import Design
        from evogymcm.algos.codesign.scoring import score_alone

        alone = score_alone(self._make_env, [Design(body, field)], self._policies)
        return float(alone.score[0]), alone.env_steps

    def of(self, search: "MaterialSearch") -> tuple[np.ndarray, int]:
        from evogymcm.algos.codesign.scoring import score_proposals

        worth, _, steps = score_proposals(self._make_env, search, self._policies)
        return worth, steps


class _GaitScores:
    """Scores of fields under the sine gait, as means over several episodes if resets are random."""

    def __init__(self, config: ImprovementConfig) -> None:
        self._task, self._body = as_task(config.task), config.design[0]

    def first(self, body: Body, field: np.ndarray) -> tuple[float, int]:
        scores, steps = self._score([field])
        return float(scores[0]), steps

    def of(self, search: "MaterialSearch") -> tuple[np.ndarray, int]:
        return self._score(list(search.ask()))

    def _score(self, fields: Sequence[np.ndarray]) -> tuple[np.ndarray, int]:
        from evogymcm.algos.learning.evaluation import draws_of, evaluate, mean_of_rows
        from evogymcm.envs import TaskEngine, sine_gait

        n, draws = len(fields), draws_of(self._task)
        options: dict[str, Any] = {"num_threads": _threads(), "with_voxels": False}
        engine = TaskEngine(self._task, [self._body] * n, draws * n, stiffness=list(fields), **options)
        engine.set_seed([world // n for world in range(draws * n)])
        try:
            result = evaluate(sine_gait, engine)
        finally:
            engine.close()
        return mean_of_rows(result.score.reshape(draws, n)), result.env_steps


def _threads() -> int:
    return max(1, usable_cores() - 1)  # one is left for those who look on
