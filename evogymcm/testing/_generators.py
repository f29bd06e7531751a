"""The random generators that all of a process share, and that nobody may draw from."""

import pickle
import random
import sys

import numpy as np


def global_generators() -> bytes:
    """Returns their states; torch's too, where it is loaded."""
    states = [np.random.get_state(), random.getstate()]  # noqa: NPY002, this is what nobody may use
    if "torch" in sys.modules:
        states.append(sys.modules["torch"].get_rng_state().numpy().tobytes())
    return pickle.dumps(states)
