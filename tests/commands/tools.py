"""Running commands in the tests."""

import pytest

from evogymcm.__main__ import main


def refused(capsys, *arguments):
    """Runs a command that must end with status 2, and returns what it says on stderr."""
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    assert stop.value.code == 2
    return capsys.readouterr().err
