"""The public names: a change of them has to be written down, and each is on the documentation's page."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module", name="api")
def _api():
    spec = importlib.util.spec_from_file_location("api", ROOT / "docs" / "api.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_public_names_are_those_written_down(api):
    assert api.LIST.read_text(encoding="utf-8") == api.listing(), "python docs/api.py --write, and look at the change"


def test_the_page_shows_all_of_them(api):
    assert api.PAGE.read_text(encoding="utf-8") == api.page(), "python docs/api.py --write"


def test_a_name_has_one_path(api):
    rooms = {}
    for line in api.listing().splitlines():
        room, _, name = re.match(r"[\w.]+", line)[0].rpartition(".")
        if room in api.ROOMS:
            rooms.setdefault(name, []).append(room)
    twice = {name: found for name, found in rooms.items() if len(found) > 1}
    assert twice == {}
