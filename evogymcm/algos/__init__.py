"""Learning, co-design, what runs leave behind, and its analysis: a room each, whose names are imported when used.

The names below are those of `evogymcm.algos.learning` and `evogymcm.algos.runs` under a shorter path.
"""

from evogymcm._doors import door
from evogymcm.algos import learning, runs

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "evogymcm.algos.codesign": ["BodyPPOConfig"],
        "evogymcm.algos.learning": learning.__all__,
        "evogymcm.algos.runs": runs.__all__,
    },
)
