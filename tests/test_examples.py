"""The example scripts: each has a check of its own."""

import pytest

from tests.examples import NAMES, load_example
from tests.registries import shorten


@pytest.mark.filterwarnings("error::FutureWarning")
@pytest.mark.usefixtures("own_registries")
@pytest.mark.parametrize("name", NAMES)
def test_example_passes_its_own_check(name):
    shorten("Walker-v0", 25)
    example = load_example(name)
    assert hasattr(example, "check"), f"examples/{name}.py: give it a function check() that runs a small version"
    example.check()
