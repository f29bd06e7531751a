"""What may go wrong with a command: its arguments, told in one line, and all else, which keeps its traceback."""

from collections.abc import Iterator
from contextlib import contextmanager


class UsageError(Exception):
    """An argument cannot be used, or the optional package that it asks for is missing."""


@contextmanager
def checking_arguments() -> Iterator[None]:
    """Turns what the library says of arguments into a UsageError.

    Only what comes before a command's work belongs in here: the same kinds of errors from the work itself are faults,
    and hiding where they come from would cost hours.

    Raises:
        UsageError: A value is not allowed, a file cannot be used, or a package is missing.
    """
    try:
        yield
    except (ValueError, OSError, ImportError) as error:
        raise UsageError(str(error)) from error
