"""How the kernels are compiled.

Without numba's runtime (`_nrt=False`) kernels can't allocate, and arrays aren't reference-counted: with it, counting at
every call cost as much as the physics (8 worlds, Walker-v0: 14,000 env-steps/s with it, 30,000 without).
"""

import logging
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba

_logger = logging.getLogger("evogymcm")

_compile: Any = partial(numba.njit, cache=True, error_model="numpy", nogil=True, _nrt=False)


def _digest() -> str:
    """Returns a digest of the simulator's sources, and of whether kernels are to check indices."""
    files = sorted(Path(__file__).parents[1].rglob("*.py"))
    checked = b"checked" * bool(numba.config.BOUNDSCHECK)
    return sha256(checked + b"".join(path.read_bytes() for path in files)).hexdigest()


_SOURCES = _digest()


def _stamped(dispatcher: Any) -> Any:
    """Ties a kernel on disk to its own file and all of the simulator's: numba alone looks at its own only.

    Kernels elsewhere call none but those of their file and the simulator's.
    """
    try:
        own = Path(dispatcher.py_func.__code__.co_filename).read_bytes()
        dispatcher._cache._cache_file._source_stamp = sha256(_SOURCES.encode() + own).hexdigest()
    except AttributeError:  # the JIT is off, or numba keeps its cache elsewhere
        return dispatcher
    return dispatcher


def kernel(function: Any) -> Any:
    """Compiles a kernel: no allocation, no Python objects, division by zero gives infinity, results kept on disk."""
    return _stamped(_compile(function))


def inner(function: Any) -> Any:
    """Compiles a kernel that only kernels call: what would take Python's arguments apart takes a sixth of the time.

    A call from Python ends the process.
    """
    return _stamped(_compile(no_cpython_wrapper=True, no_cfunc_wrapper=True)(function))


def inlined(function: Any) -> Any:
    """Compiles an inner part that is to be inlined where it is called.

    Seven words an array go over the stack in a call: what a substep calls once took a fifth of it for that.
    """
    return _stamped(_compile(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)(function))


def entry(function: Any, *example: Any) -> Any:
    """Returns a kernel as compiled for arguments of the example's types: what is called must be of just these.

    Numba's own call looks at the type of each argument, which for a few named tuples takes two microseconds.
    """
    if not hasattr(function, "compile"):  # the JIT is off
        return function
    return function.compile(tuple(numba.typeof(value) for value in example))


@cache
def announce_compilation(function: Any) -> None:
    """Logs a warning, once, where a kernel is neither loaded nor on disk, so that a first wait is explained."""
    try:
        is_ready = bool(function.signatures) or bool(function._cache._cache_file._load_index())
    except AttributeError:  # the JIT is off, or numba keeps its cache elsewhere
        return
    if not is_ready:
        _logger.warning("compiling the simulator's kernels, once on this machine (about 20 s) ...")
