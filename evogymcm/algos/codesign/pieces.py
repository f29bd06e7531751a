"""The pieces of a generation: work on a few of its designs that depends on no other's, done anywhere to the same bits.

Each of them takes `tell`, to be called with the env-steps that it has simulated so far, and `should_stop`; it returns
None where it was stopped.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from evogymcm.algos.codesign.body_ppo import BodyPPOConfig
from evogymcm.algos.codesign.config import SearchConfig
from evogymcm.algos.codesign.design import Design, Individual
from evogymcm.algos.codesign.inner_loop import MakeEnv, Policy, Trained, train_designs
from evogymcm.algos.codesign.material_search import MaterialSearch
from evogymcm.algos.codesign.scoring import Scores, score_alone, score_proposals, score_together
from evogymcm.algos.learning.config import Selection
from evogymcm.algos.runs.folder import RunFolder

Tell = Callable[[int], None]
ShouldStop = Callable[[], bool]

_SCREENED = 8  # mutants of a child that are played at a time, between looks whether to stop


@dataclass(frozen=True)
class Place:
    """Where a training is kept, so that it can be resumed: in a folder, with what it says of itself.

    Workers that do not see the folder's parent `root` keep it in memory.
    """

    root: Path
    name: str
    settings: Mapping[str, Any]

    def open(self) -> RunFolder | None:
        """Returns the folder, None where it cannot be seen."""
        path = self.root / self.name
        return RunFolder(path, self.settings, resume=path.exists()) if self.root.is_dir() else None


def train_piece(
    make_env: MakeEnv,
    designs: Sequence[Design],
    ppo: BodyPPOConfig,
    initial: Sequence[Policy] | None,
    place: Place | None,
    *,
    tell: Tell,
    should_stop: ShouldStop,
) -> Trained | None:
    """Trains designs together, see `train_designs`."""
    trained = train_designs(
        make_env,
        designs,
        ppo,
        run=None if place is None else place.open(),
        initial=initial,
        progress=lambda state: tell(state.env_steps),
        should_stop=should_stop,
    )
    return trained if trained.finished else None


def score_piece(
    make_env: MakeEnv,
    designs: Sequence[Design],
    policies: Sequence[Policy],
    starts: int,
    *,
    tell: Tell,
    should_stop: ShouldStop,
) -> Scores:
    """Scores designs as if each were alone, see `score_alone`; too short to be stopped."""
    return score_alone(make_env, designs, policies, starts=starts)


@dataclass(frozen=True)
class Screened:
    """Scores of the mutants of some children, (P, C), and the env-steps that they took."""

    scores: np.ndarray
    env_steps: int


def screen_piece(
    make_env: MakeEnv,
    groups: Sequence[Sequence[Design]],
    policies: Sequence[Policy],
    *,
    tell: Tell,
    should_stop: ShouldStop,
) -> Screened | None:
    """Plays the mutants of some children under their parents' policies."""
    scores, steps = [], 0
    for begin in range(0, len(groups[0]), _SCREENED):
        if should_stop():
            return None  # no more than a screening is lost
        some = score_together(make_env, [group[begin : begin + _SCREENED] for group in groups], policies)
        scores.append(some.score)
        steps += some.env_steps
        tell(steps)
    return Screened(np.concatenate(scores, axis=1), steps)


@dataclass(frozen=True)
class Searched:
    """The best fields of some survivors with their scores, and what the table says of those that changed, by index."""

    fields: np.ndarray
    scores: np.ndarray
    told: dict[int, dict[str, float]]
    env_steps: int


def search_piece(
    make_env: MakeEnv,
    survivors: Sequence[Individual],
    policies: Sequence[Policy],
    config: SearchConfig,
    seed: int,
    starts: int,
    selection: Selection,
    *,
    tell: Tell,
    should_stop: ShouldStop,
) -> Searched | None:
    """Searches some survivors' stiffness fields under their present policies."""
    search = MaterialSearch(survivors, seed=seed, **asdict(config))
    told, steps = dict[int, dict[str, float]](), 0
    while not search.is_finished:
        if should_stop():
            return None  # no more than a search is lost
        scores, rows, spent = score_proposals(make_env, search, policies, starts, selection)
        told |= {survivors[i].index: rows[i] for i in np.flatnonzero(search.tell(scores)).tolist()}
        steps += spent
        tell(steps)
    return Searched(*search.best, told, steps)
