"""From a surface's fine pixels to a picture: means of 2 x 2, which smooths edges."""

import numpy as np

from evogymcm.sim.kernels._jit import kernel

FINE = 2  # fine pixels to a pixel, across and up
_RED_BLUE, _GREEN = np.uint32(0xFF00FF), np.uint32(0x00FF00)
_HALVES = np.uint32(0x020002), np.uint32(0x000200)  # for rounding


def downscale(fine: np.ndarray) -> np.ndarray:
    """Returns the uint8 (height, width, 3) picture of (2 * height, 2 * width) uint32 pixels 0xRRGGBB."""
    picture = np.empty((fine.shape[0] // FINE, fine.shape[1] // FINE, 3), np.uint8)
    _downscale(fine, picture)
    return picture


@kernel
def _downscale(fine: np.ndarray, picture: np.ndarray) -> None:
    """Sums red and blue of four pixels in one number; takes a fifth of pygame's smoothscale and tobytes together."""
    for y in range(picture.shape[0]):
        for x in range(picture.shape[1]):
            a, b = fine[2 * y, 2 * x], fine[2 * y, 2 * x + 1]
            c, d = fine[2 * y + 1, 2 * x], fine[2 * y + 1, 2 * x + 1]
            both = (a & _RED_BLUE) + (b & _RED_BLUE) + (c & _RED_BLUE) + (d & _RED_BLUE) + _HALVES[0]
            green = (a & _GREEN) + (b & _GREEN) + (c & _GREEN) + (d & _GREEN) + _HALVES[1]
            picture[y, x, 0] = both >> np.uint32(18)
            picture[y, x, 1] = (green >> np.uint32(10)) & np.uint32(255)
            picture[y, x, 2] = (both >> np.uint32(2)) & np.uint32(255)
