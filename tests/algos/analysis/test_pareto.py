"""The Pareto front."""

import numpy as np
import pytest

from evogymcm.algos.analysis import pareto_front


def test_the_front_is_what_none_beats_in_score_and_work():
    #        best   cheaper  as cheap, worse  beaten  twin of cheaper
    score = [5.0, 4.0, 3.0, 3.5, 4.0]
    work = [9.0, 2.0, 2.0, 5.0, 2.0]
    assert pareto_front(score, work).tolist() == [True, True, False, False, True]
    assert pareto_front(score, np.transpose([work, [1, 1, 0, 1, 1]])).tolist() == [True, True, True, False, True]
    assert pareto_front([], []).tolist() == []


@pytest.mark.parametrize(("gains", "costs"), [([1.0], [1.0, 2.0]), (1.0, 2.0), ([np.nan], [1.0]), ([1.0], [np.nan])])
def test_what_cannot_be_compared_is_refused(gains, costs):
    with pytest.raises(ValueError, match="gains, costs: got "):
        pareto_front(gains, costs)
