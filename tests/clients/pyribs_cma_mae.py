# /// script
# requires-python = ">=3.11"
# dependencies = ["evogymcm[qd]"]
# ///
"""CMA-MAE of pyribs over the stiffness of one body: an archive by how stiff actuators and other voxels are."""

from dataclasses import replace

import numpy as np
from ribs.archives import GridArchive
from ribs.emitters import EvolutionStrategyEmitter
from ribs.schedulers import Scheduler

import evogymcm as cm
from evogymcm.algos import evaluate
from evogymcm.envs import TaskEngine, sine_gait
from evogymcm.sim.constants import STIFFNESS_HIGH, STIFFNESS_LOW

TASK = replace(cm.tasks["Walker-v0"], time_limit=40)
BODY = cm.Body.from_text("HHH/S.V")
N, BATCH = BODY.n_voxels, 12
ACTING = np.isin(np.flatnonzero(BODY.occupancy), BODY.actuators)


def scores(stiffness):
    """Returns the score of each field; all are simulated together."""
    fields = np.ones((len(stiffness), *BODY.shape))
    fields[:, BODY.occupancy] = stiffness
    worlds = TaskEngine(TASK, [BODY] * len(stiffness), stiffness=fields, with_voxels=False)
    return evaluate(sine_gait, worlds).score


def search(rounds):
    """Returns the archive, and its QD score after each round."""
    limits = (STIFFNESS_LOW, STIFFNESS_HIGH)
    grid = {"solution_dim": N, "dims": (5, 5), "ranges": [limits, limits], "qd_score_offset": -1.0}
    archive, result = GridArchive(**grid, learning_rate=0.1, threshold_min=-1.0), GridArchive(**grid)
    bounds = [tuple(np.log(limits))] * N  # solutions are logarithms of stiffness
    emitters = [
        EvolutionStrategyEmitter(
            archive, x0=np.zeros(N), sigma0=0.3, bounds=bounds, ranker="imp", batch_size=BATCH, seed=seed
        )
        for seed in range(2)
    ]
    scheduler = Scheduler(archive, emitters, result_archive=result)
    history = []
    for _ in range(rounds):
        stiffness = np.exp(scheduler.ask())
        measures = np.stack([stiffness[:, ACTING].mean(1), stiffness[:, ~ACTING].mean(1)], axis=1)
        scheduler.tell(scores(stiffness), measures)
        history.append(result.stats.qd_score)
    return result, history


def main():
    plain = scores(np.ones((1, N)))[0]
    archive, history = search(6)
    assert archive.stats.num_elites >= 8
    assert history[-1] > history[0]
    best = archive.best_elite
    assert best["objective"] > plain, "no field is better than 1 everywhere"
    assert scores(np.exp(best["solution"])[None]) == best["objective"], "a score does not depend on the batch"
    np.testing.assert_array_equal(search(2)[1], history[:2])


if __name__ == "__main__":
    main()
