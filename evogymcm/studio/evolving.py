"""Bodies that evolve in a process of their own, and their family tree as it grows."""

import os
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

from evogymcm.algos.codesign.body_ppo import BodyPPOConfig
from evogymcm.algos.codesign.config import CodesignConfig, SearchConfig
from evogymcm.algos.runs.folder import RunFolder
from evogymcm.algos.runs.older import present_settings
from evogymcm.algos.runs.origin import usable_cores
from evogymcm.algos.runs.record import RunRecord, best_curve
from evogymcm.studio.processes import Job, Tell

SMALL = CodesignConfig(  # some minutes
    material="invariant",
    population=6,
    budget=24,
    inherit=True,
    piece=None,  # one batch, whose worlds are simulated by several threads
    num_threads=max(1, usable_cores() - 1),
    ppo=BodyPPOConfig(total_steps=20_000, eval_interval=5_000),
)


class Evolution(Job):
    """Evolves bodies with their policies, in a process of its own.

    The folder is one of `codesign`: `evogymcm codesign`, `watch` and `report` take it too.

        evolution = Evolution("runs/family", replace(SMALL, task="BridgeWalker-v0"))
        evolution.start()
        evolution.tree()["nodes"]

    Args:
        folder: Of the run; made when it starts.
        config: Settings; by default a small run in Walker-v0. Of a world's file as task the folder gets a copy.
    """

    kind = "codesign"
    _given: CodesignConfig | None = None

    def __init__(self, folder: str | os.PathLike[str], config: CodesignConfig = SMALL) -> None:
        self._given = config
        super().__init__(folder, replace(config, task=self._own(folder, config.task)))

    @classmethod
    def read_config(cls, saved: Mapping[str, Any]) -> CodesignConfig:
        """Returns the settings of a co-design run."""
        saved = present_settings(saved)
        search = None if saved["search"] is None else SearchConfig(**saved["search"])
        own = {item.name: saved[item.name] for item in fields(CodesignConfig) if item.name in saved}
        return CodesignConfig(**{**own, "search": search, "ppo": BodyPPOConfig(**saved["ppo"])})

    def check(self) -> None:
        """Raises a ValueError where such a run cannot start."""
        from evogymcm.algos.codesign.start import check_start

        check_start(self._given or self.config)

    def work(self, run: RunFolder, should_stop: Callable[[], bool], tell: Tell) -> bool:
        """Evolves to the end of the budget, or until it should stop."""
        from evogymcm.algos.codesign.codesigning import codesign
        from evogymcm.algos.learning.memory import keep_freed_memory

        keep_freed_memory()
        return codesign(
            self.config, run=run, progress=lambda now: tell(vars(now)), should_stop=should_stop, workers=1
        ).finished

    @property
    def has_finished(self) -> bool:
        """Whether the budget is used."""
        return bool(self.files.read_json("result.json").get("finished"))

    def progress(self, told: Mapping[str, Any]) -> dict[str, Any]:
        """Returns how far it is.

        | key | what |
        | --- | --- |
        | `env_steps`, `total` | simulated so far, and all at most |
        | `curve` | (env-steps, best score so far) |
        | `phase`, `generation` | what is done at present: "train", "search" and so on, None at first |
        | `n_designs`, `budget` | bodies proposed so far, and all |
        """
        from evogymcm.algos.codesign.plan import cost_of

        rows = self.files.rows()
        done = rows[-1]["env_steps"] if rows else 0
        return {
            "env_steps": max(done, told.get("env_steps", 0)),
            "total": cost_of(self.config).total,
            "curve": list(best_curve(rows)),
            "phase": told.get("phase"),
            "generation": told.get("generation", 0),
            "n_designs": max(told.get("n_designs", 0), len({row["index"] for row in rows})),
            "budget": self.config.budget,
        }

    def tree(self) -> dict[str, Any]:
        """Returns the family tree of all designs that have a score.

        | key | what |
        | --- | --- |
        | `nodes` | one a design, oldest first |
        | `edges` | (parent, child) indices |

        A node has `index`, `parent` (None for a random body), `generation`, `body` (text), `stiffness` (rows, columns),
        `score`, `policy` (its file), `is_best`, and `is_line` (whether it is the best or an ancestor of it).
        """
        from evogymcm.report.lineage import ancestors

        if not (self.folder / "curve.jsonl").is_file():
            return {"nodes": [], "edges": []}
        run = RunRecord.read(self.folder)
        ranked = run.ranked()
        line = ancestors(run.designs, ranked[0]["index"]) if ranked else []
        nodes = []
        for row in sorted(ranked, key=lambda row: row["index"]):
            body, stiffness = run.design(row)
            policy = self.folder / f"policy-{row['index']:04}.pt"
            node = {name: row.get(name) for name in ("index", "parent", "generation")}
            node |= {"body": body.text, "stiffness": stiffness.tolist(), "score": row["fitness"]}
            node |= {"policy": str(policy) if policy.is_file() else None}
            nodes.append(node | {"is_best": row is ranked[0], "is_line": row["index"] in line})
        edges = [(node["parent"], node["index"]) for node in nodes if node["parent"] is not None]
        return {"nodes": nodes, "edges": edges}
