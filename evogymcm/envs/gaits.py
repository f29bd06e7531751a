"""A simple gait, to see robots move without a policy."""

import numpy as np

from evogymcm.envs.engines import engine_of


def sine_gait(env: object, period: float = 25.0, amplitude: float = 0.5) -> tuple[np.ndarray, np.ndarray | None]:
    """Returns actions for `TaskEngine.step`: waves that run through the body, by which many bodies walk.

    Args:
        env: The environment to act in, or its engine; the phase follows the env-steps of each world's episode.
        period: Env-steps of a cycle.
        amplitude: How far the actuation swings to each side of its neutral value 1.

    Returns:
        (N, V) actuation, and (N, V) stiffness (a wave from 0.5 to 2) in the reactive setting, else None.

    Raises:
        ValueError: There is no engine in `env`.
    """
    engine = engine_of(env)
    rows, columns = np.divmod(np.arange(engine.occupancy.shape[1]), engine.grid_shape[1])
    phase = 2 * np.pi * (engine.length[:, None] / period - columns / (2 * engine.grid_shape[1]) - rows / 8)
    actuation = 1.0 + amplitude * np.sin(phase)
    return actuation, 2.0 ** np.cos(phase) if engine.material == "reactive" else None
