"""The C library's memory, kept while training: gradient steps free and take the same megabytes thousands of times."""

import ctypes
import sys

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3  # options of glibc's mallopt


def keep_freed_memory() -> bool:
    """Lets this process reuse freed memory instead of returning it to the system and faulting it in again.

    This changes a setting of the whole process, so programs call it once at their start; no module of this library does
    so on import.

    Returns:
        Whether it took effect, which is so with glibc (Linux) only.
    """
    if sys.platform != "linux":
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    options = ((_MMAP_THRESHOLD, 1 << 25), (_TRIM_THRESHOLD, 1 << 30), (_TOP_PAD, 1 << 26))
    return all(mallopt(option, value) == 1 for option, value in options)  # the first alone would do harm
