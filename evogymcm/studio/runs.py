"""The runs of designs: their folders within the studio's, the policies in them, and the work that goes on in them."""

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evogymcm._messages import brief
from evogymcm._settings import check_count
from evogymcm.algos.baselines import has_baseline
from evogymcm.algos.learning.config import BASELINE
from evogymcm.studio.store import GAITS, RUN, Store, check_policy

if TYPE_CHECKING:  # they load torch or numba when they are used
    from evogymcm.studio.processes import Job
    from evogymcm.studio.watching import Wanted

TRAIN, MATERIAL, EVOLVE = "train", "material", "evolve"
KINDS = {TRAIN: "Training", MATERIAL: "Better material", EVOLVE: "Evolution"}
SINE = "sine"
_FILES = ("final.pt", "checkpoint.pt")  # policies of a training, the better one first


class Runs:
    """The runs in a studio's folder.

    Args:
        store: The folder.
        given: Folders of runs elsewhere, or files of policies, that may be used too.

    Raises:
        ValueError: One of those given is not there.
    """

    def __init__(self, store: Store, given: Sequence[str | os.PathLike[str]] = ()) -> None:
        self._store = store
        self._given: dict[str, Path] = {}
        for path in map(Path, given):
            if not path.exists():
                raise ValueError(f"policy: there is no {path}")
            name = path.resolve().name
            alike = sum(other.name == name for other in self._given.values())
            self._given[f"given:{name}{f' ({alike + 1})' if alike else ''}"] = path.resolve()
        self._jobs: dict[Path, Job] = {}

    def names(self, id: str, kind: str | None = None) -> list[str]:
        """Returns the names of a design's runs, the oldest of each kind first."""
        found = []
        folder = self._store.runs(id)
        for path in folder.iterdir() if folder.is_dir() else ():
            match = RUN.fullmatch(path.name)
            if match and kind in (None, match[1]) and (path / "config.json").is_file():
                found.append((match[1], int(match[2])))
        return [f"{name}-{number}" for name, number in sorted(found)]

    def folder(self, id: str, name: str) -> Path:
        """Returns the folder of a run, which need not exist.

        Raises:
            ValueError: The name is none of a run, or leads out of the studio's folder.
        """
        if not isinstance(name, str) or not RUN.fullmatch(name):
            raise ValueError(f"run: got {brief(name)}, expected a name such as {TRAIN}-1")
        path = self._store.runs(id) / name
        if not path.resolve().is_relative_to(self._store.folder):
            raise ValueError(f"run: {name} leads out of the folder")
        return path

    def policy(self, policy: str) -> tuple[str, int]:
        """Returns a policy as `Player` takes it, and a number that changes when its file does.

        A run that has none yet gives a sine gait.

        Raises:
            ValueError: It is no policy, of no run, or was not given.
        """
        if check_policy(policy).startswith("given:"):
            if policy not in self._given:
                raise ValueError(f"policy: {title_of_given(policy)} was not given to this studio (--policy)")
            path = self._given[policy]
            files = [path / file for file in _FILES if (path / file).is_file()] or [path]
            return str(path), files[0].stat().st_mtime_ns
        if "/" not in policy:
            return policy, 0
        id, name, *rest = policy.split("/")
        folder = self.folder(id, name)
        names = [f"{rest[0]}.pt"] if rest else _FILES
        for path in (folder / name for name in names):
            with suppress(FileNotFoundError):
                return str(path), path.stat().st_mtime_ns
        if rest or not (folder / "config.json").is_file():
            raise ValueError(f"policy: {id} has no {label(name)}{' with ' + rest[0] if rest else ''}")
        return SINE, 0

    def policies(self, task: str, material: str) -> dict[str, str]:
        """Returns what can move a robot in a task, and what to call it: gaits, and policies that there are."""
        found = dict(GAITS)
        if has_baseline(task, material):
            found[BASELINE] = "Baseline policy"
        found |= {policy: title_of_given(policy) for policy in self._given}
        for entry in self._store.entries():
            for name in self.names(entry.id, TRAIN):
                if any((self.folder(entry.id, name) / file).is_file() for file in _FILES):
                    found[f"{entry.id}/{name}"] = f"{entry.name}: {label(name)}"
        return found

    def title(self, policy: str) -> str:
        """Returns what to call a policy, there or not."""
        if policy.startswith("given:"):
            return title_of_given(policy)
        if "/" not in policy:
            return GAITS.get(policy, "Baseline policy")
        id, name, *rest = policy.split("/")
        return f"{id}: {label(name)}" + (f", design {int(rest[0].split('-')[1])}" if rest else "")

    def latest(self, id: str, kind: str) -> "Job | None":
        """Returns the newest work of a kind on a design, None where there is none.

        Raises:
            ValueError: Its folder cannot be read.
        """
        names = self.names(id, kind)
        if not names:
            return None
        folder = self.folder(id, names[-1])
        if folder not in self._jobs:
            self._jobs[folder] = _classes()[kind].open(folder)
        return self._jobs[folder]

    def check_idle(self, id: str) -> None:
        """Raises a ValueError where a run of a design is at work."""
        for kind in KINDS:
            job = self.latest(id, kind)
            if job is not None and job.is_running:
                raise ValueError(f"{label(job.folder.name)} is running; stop it first.")

    def _new(self, id: str, kind: str) -> Path:
        names = self.names(id, kind)
        number = 1 + (int(names[-1].split("-")[1]) if names else 0)
        return self.folder(id, f"{kind}-{number}")

    def _start(self, job: "Job") -> "Job":
        job.start()
        self._jobs[job.folder] = job
        return job

    def train(self, id: str, wanted: "Wanted", steps: int) -> "Job":
        """Begins to train a policy for what is seen, from the policy that moves it unless that is a gait.

        Raises:
            ValueError: It cannot be trained so.
            OSError: Its folder cannot be written.
        """
        from evogymcm.studio.learning import PPO, Learning
        from evogymcm.studio.watching import read_field

        design = (wanted.body, read_field(wanted), wanted.task, wanted.material)
        initial = None if wanted.policy in GAITS else wanted.policy
        return self._start(Learning(self._new(id, TRAIN), *design, _paced(PPO, steps), initial))

    def improve(self, id: str, wanted: "Wanted", rounds: int) -> "Job":
        """Begins to search a better stiffness field for what is seen, and returns the work; errors as `train`."""
        from evogymcm.studio.improving import SEARCH, MaterialImprovement
        from evogymcm.studio.watching import read_field

        if wanted.policy in GAITS and wanted.policy != SINE:
            raise ValueError("It needs the sine gait or a trained policy: choose one under “Moved by”.")
        if wanted.material == "reactive":
            raise ValueError("In the reactive setting stiffness belongs to what moves the robot, not to its material.")
        search = replace(SEARCH, rounds=check_count("rounds", rounds))
        folder = self._new(id, MATERIAL)
        job = MaterialImprovement(folder, wanted.body, read_field(wanted), wanted.task, wanted.policy, search)
        return self._start(job)

    def evolve(
        self, id: str, wanted: "Wanted", shape: tuple[int, int], population: int, budget: int, steps: int
    ) -> "Job":
        """Begins to evolve bodies of a grid's shape, each trained for so many env-steps; errors as `train`."""
        from evogymcm.studio.evolving import SMALL, Evolution

        if not (shape[0] >= 2 and shape[1] >= 2):
            raise ValueError("Bodies that evolve need at least 2 rows and 2 columns.")
        options: dict[str, Any] = {
            "task": wanted.task,
            "material": wanted.material,
            "shape": shape,
            "population": check_count("population", population, 2),
            "budget": check_count("designs", budget),
            "ppo": _paced(SMALL.ppo, steps),
        }
        config = replace(SMALL, **options)
        return self._start(Evolution(self._new(id, EVOLVE), config))


def _paced(ppo: Any, steps: int) -> Any:
    """Returns settings of PPO with so many env-steps, and some evaluations within them."""
    steps = check_count("env-steps", steps, 1000)
    return replace(ppo, total_steps=steps, eval_interval=min(ppo.eval_interval, steps // 4))


def title_of_given(policy: str) -> str:
    """Returns what a policy is called that the studio was given."""
    return f"Run {policy.removeprefix('given:')}"


def label(run: str) -> str:
    """Returns what a run is called."""
    kind, number = run.split("-")
    return f"{KINDS[kind]} {number}"


def _classes() -> dict[str, Any]:
    from evogymcm.studio.evolving import Evolution
    from evogymcm.studio.improving import MaterialImprovement
    from evogymcm.studio.learning import Learning

    return {TRAIN: Learning, MATERIAL: MaterialImprovement, EVOLVE: Evolution}
