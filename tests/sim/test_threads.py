"""Sharing out worlds to threads: every world once, in pieces that balance, with no thread at work after an error."""

import threading
import time
from itertools import pairwise

import numpy as np
import pytest

from evogymcm.sim._threads import _PAYS, _SMALLEST, Threads, _ends


@pytest.fixture
def threads():
    threads = Threads(2)
    yield threads
    threads.close()


def run(threads, costs, job=lambda worlds, thread: None):
    """The pieces that were handed out, in the order in which they ended, with the threads' numbers."""
    pieces = []

    def noted(worlds, thread):
        job(worlds, thread)
        pieces.append((worlds.tolist(), thread))

    threads.run(noted, np.arange(len(costs)), np.array(costs))
    return pieces


@pytest.mark.parametrize("n", [2, 5])
def test_pieces_become_smaller_and_hold_every_world_once(n):
    costs = np.random.default_rng(0).integers(20, 400, 256)
    ends = list(_ends(np.cumsum(costs).tolist(), n))
    assert ends[0] == 0
    assert ends[-1] == len(costs)
    sizes = [int(costs[start:end].sum()) for start, end in pairwise(ends)]
    assert len(sizes) < 14 * n
    share = costs.sum() / n
    assert share / 3 < sizes[0] < 0.6 * share
    # Each is at most half of what is left for a thread, but for the world at its end: the last ones end together.
    left = costs.sum() - np.cumsum([0, *sizes[:-1]])
    assert all(0 < size <= max(rest / (2 * n), _SMALLEST) + 400 for size, rest in zip(sizes, left, strict=True))
    assert sizes[-1] <= _SMALLEST + 400


@pytest.mark.parametrize("costs", [[5000], [1, 5000], [5000, 1], [900] * 3, [0, 5000, 0, 0]])
def test_few_or_uneven_worlds_are_shared_out_whole(threads, costs):
    assert sorted(world for worlds, _ in run(threads, costs) for world in worlds) == list(range(len(costs)))


def test_small_batches_wake_no_thread(threads):
    before = threading.active_count()
    assert run(threads, [1] * 30) == [(list(range(30)), 0)]
    assert run(threads, [_PAYS - 1, _PAYS]) == [([0, 1], 0)]
    assert threading.active_count() == before
    run(threads, [_PAYS, _PAYS])
    assert threading.active_count() == before + 1


def test_a_thread_that_is_busy_elsewhere_is_not_waited_for(threads):
    run(threads, [_PAYS] * 2)
    let_go = threading.Event()
    busy = threads._pool.submit(let_go.wait, 60)  # as on a machine whose other core is taken
    assert {thread for _, thread in run(threads, [_PAYS] * 8)} == {0}
    assert not busy.done()
    let_go.set()


@pytest.mark.parametrize("culprit", [0, 1])
def test_after_an_error_no_thread_is_at_work(threads, culprit):
    both, at_work, begun = threading.Barrier(2, timeout=300), set(), set()

    def job(worlds, thread):
        if thread not in begun:
            begun.add(thread)
            both.wait()
        if thread == culprit:
            raise RuntimeError("out of order")
        at_work.add(thread)
        time.sleep(0.05)
        at_work.remove(thread)

    with pytest.raises(RuntimeError, match="out of order"):
        run(threads, [_PAYS] * 64, job)
    assert not at_work
    run(threads, [_PAYS] * 8)  # and the threads go on
