"""Learning, co-design, stored runs and their analysis, a package each; names are imported when they are first used.

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
