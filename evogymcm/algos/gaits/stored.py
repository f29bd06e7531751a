"""Gaits in files, with what they were found for."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from evogymcm._files import write_atomic
from evogymcm.algos.gaits.search import FoundGaits
from evogymcm.algos.gaits.wave import Waves
from evogymcm.algos.learning.bodies import as_texts
from evogymcm.algos.runs.origin import find_origin
from evogymcm.algos.runs.record import GAIT
from evogymcm.body import Body, as_body
from evogymcm.envs.core import TaskEngine


@dataclass(frozen=True, eq=False)
class SavedGaits:
    """Gaits of D designs, and what they were found for.

    Attributes:
        task: The task's id.
        bodies: The D bodies.
        material: The setting.
        stiffness: A field for each body; None for 1 everywhere, or set by the gait.
        edge_rule: How stiffness acts on shared edges.
        waves: The gaits.
        score: Their scores in the search.
    """

    task: str
    bodies: tuple[Body, ...]
    material: str
    stiffness: tuple[np.ndarray, ...] | None
    edge_rule: str
    waves: Waves
    score: tuple[float, ...]

    def make_engine(self, num_worlds: int | None = None, **options: Any) -> TaskEngine:
        """Returns worlds like those of the search, D by default; `options` of `TaskEngine` come before its own."""
        fields = None if self.stiffness is None else list(self.stiffness)
        settings: dict[str, Any] = {"task": self.task, "bodies": list(self.bodies), "num_worlds": num_worlds}
        settings |= {"material": self.material, "stiffness": fields, "edge_rule": self.edge_rule}
        return TaskEngine(**settings | options)


def save_gaits(
    path: str | os.PathLike[str],
    found: FoundGaits,
    task: str,
    bodies: Any,
    *,
    stiffness: Any = None,
    edge_rule: str = "mean_factor",
) -> None:
    """Writes gaits to a JSON file, atomically.

    Args:
        path: The file.
        found: What `search_gaits` returned.
        task: Id of the task, as it was given to the search.
        bodies: The D bodies, as they were given to the search.
        stiffness: The fields, one for each body, as they were given to the search.
        edge_rule: As it was given to the search.

    Raises:
        ValueError: There is not one gait for each body.
    """
    texts, path = as_texts(bodies), Path(path)
    if len(texts) != len(found.score):
        raise ValueError(f"bodies: got {len(texts)}, expected one for each of {len(found.score)} gaits")
    told = {
        "kind": "gaits",
        "task": task,
        "bodies": texts,
        "material": found.waves.material,
        "stiffness": None if stiffness is None else [np.asarray(field).tolist() for field in stiffness],
        "edge_rule": edge_rule,
        "gaits": found.waves.settings,
        "values": found.waves.values.tolist(),
        "cells": None if found.waves.cells is None else found.waves.cells.tolist(),
        "score": found.score.tolist(),
        "env_steps": found.env_steps.tolist(),
        "origin": find_origin(),
    }
    write_atomic(path, lambda part: part.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8"))


def load_gaits(path: str | os.PathLike[str]) -> SavedGaits:
    """Returns what `save_gaits` wrote.

    Args:
        path: The file, or the folder of an evolution (`evolve`), whose best design it returns.

    Raises:
        ValueError: The file holds no gaits.
        FileNotFoundError: There is no such file.
    """
    path = gaits_in(path) or Path(path)
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        if told["kind"] != "gaits":
            raise KeyError("kind")
        bodies, fields = tuple(map(as_body, told["bodies"])), told["stiffness"]
        waves, score = Waves(told["values"], told.get("cells")), tuple(map(float, told["score"]))
        if not len(bodies) == len(waves.values) == len(score):
            raise KeyError("values")
        stiffness = None if fields is None else tuple(np.array(field, np.float64) for field in fields)
        return SavedGaits(told["task"], bodies, waves.material, stiffness, told["edge_rule"], waves, score)
    except (ValueError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise ValueError(f"gaits: {path} cannot be read as gaits: {error!r}") from error


def gaits_in(path: str | os.PathLike[str]) -> Path | None:
    """Returns the file of gaits that is meant by a path, None where it is none: a .json file, or the folder of one."""
    path = Path(path)
    if path.suffix == ".json" and not path.is_dir():
        return path
    return path / GAIT if (path / GAIT).is_file() else None
