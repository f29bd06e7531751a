"""Colours of voxels, told apart by lightness and by orange against blue, so that colour-blind people can read them.

A colour has three independent parts: its hue says what a voxel is, its saturation how far an actuator is stretched, and
its brightness how stiff the voxel is.
"""

from functools import lru_cache

import numpy as np

from evogymcm.sim.constants import FIXED, H_ACT, N_CODES, RIGID, SOFT, STIFFNESS_HIGH, STIFFNESS_LOW, V_ACT

Color = tuple[int, int, int]

SKY: Color = (249, 251, 254)
FLOOR: Color = (212, 217, 222)  # the implicit floor, below y = 0
PANEL: Color = (255, 255, 255)
INK: Color = (25, 28, 33)
GOAL: Color = (0, 120, 90)
NEUTRAL: Color = (205, 208, 212)  # what has no stiffness of its own, in the stiffness view
NEUTRAL_FIXED: Color = (165, 169, 174)

STRETCH_LOW, STRETCH_HIGH = 0.7, 1.4  # lengths (of rest) at which saturation ends
_BRIGHTNESS = 0.9  # at S = 1
# By voxel code: hue as pure colour, saturation, value. Values leave room for the brightness 0.9 / sqrt(0.5).
_HUE = np.zeros((N_CODES, 3))
_HUE[[RIGID, SOFT, H_ACT, V_ACT, FIXED]] = [
    (0.0, 0.3, 1.0),
    (0.0, 0.3, 1.0),
    (1.0, 0.5, 0.0),
    (0.0, 0.45, 1.0),
    (0.0, 0.4, 1.0),
]
_SATURATION = np.zeros(N_CODES)
_SATURATION[[RIGID, SOFT, FIXED]] = [0.12, 0.04, 0.10]
_VALUE = np.zeros(N_CODES)
_VALUE[[RIGID, SOFT, H_ACT, V_ACT, FIXED]] = [0.26, 0.72, 0.78, 0.78, 0.55]
_SATURATED, _PALE = 1.0, 0.35  # an actuator at its shortest and longest
# Matplotlib's viridis, from its dark end, in eighths.
_VIRIDIS = np.array(
    [
        (68, 1, 84),
        (71, 44, 122),
        (59, 81, 139),
        (44, 113, 142),
        (33, 144, 141),
        (39, 173, 129),
        (92, 200, 99),
        (170, 220, 50),
        (253, 231, 37),
    ],
    float,
)


def type_colors(codes: np.ndarray, stretch: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Returns (n, 3) int colours by type, darker where stiffer (0.9 / sqrt(S)), paler where an actuator is longer.

    Args:
        codes: (n,) voxel codes.
        stretch: (n,) length of the actuators' driven sides, relative to rest; without effect for other voxels.
        stiffness: (n,) factors S.
    """
    longer = np.clip((stretch - STRETCH_LOW) / (STRETCH_HIGH - STRETCH_LOW), 0.0, 1.0)
    is_actuator = (codes == H_ACT) | (codes == V_ACT)
    saturation = np.where(is_actuator, _SATURATED + (_PALE - _SATURATED) * longer, _SATURATION[codes])
    value = np.minimum(_VALUE[codes] * _BRIGHTNESS / np.sqrt(stiffness), 1.0)
    rgb = value[:, None] * (1.0 - saturation[:, None] * (1.0 - _HUE[codes]))
    return np.rint(255 * rgb).astype(int)


def stiffness_colors(stiffness: np.ndarray) -> np.ndarray:
    """Returns (n, 3) int colours by stiffness alone: viridis over log S, dark where stiff."""
    span = np.log(STIFFNESS_HIGH / STIFFNESS_LOW)
    at = np.clip(np.log(STIFFNESS_HIGH / np.asarray(stiffness, float)) / span, 0.0, 1.0) * (len(_VIRIDIS) - 1)
    eighths = np.arange(len(_VIRIDIS))
    return np.rint(np.stack([np.interp(at, eighths, channel) for channel in _VIRIDIS.T], axis=-1)).astype(int)


@lru_cache
def type_color(code: int, stretch: float = 1.0, stiffness: float = 1.0) -> Color:
    """Returns the colour of one voxel, see `type_colors`."""
    red, green, blue = type_colors(np.array([code]), np.array([stretch]), np.array([stiffness]))[0]
    return int(red), int(green), int(blue)


@lru_cache
def shade(color: Color, factor: float) -> Color:
    """Returns a colour made darker (below 1) or lighter."""
    red, green, blue = (min(round(factor * part), 255) for part in color)
    return red, green, blue
