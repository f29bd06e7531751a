"""Designs as files: nothing outside the folder is opened, nothing is lost."""

import errno
import io
import json
import os
import time

import numpy as np
import pytest

from evogymcm import Body
from evogymcm.sim import World, WorldObject
from evogymcm.studio import Drawing, sessions
from evogymcm.studio.sessions import Studio
from evogymcm.studio.store import TERRAIN, Design, Store


@pytest.fixture(name="store")
def _store(tmp_path):
    return Store(tmp_path / "robots")


def wait_for(condition, seconds=120.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_design_comes_back_as_it_was(store):
    design = Design("Räd <b>bot</b>", "Climber-v0", "reactive", "random", Drawing.of("Walk_Bot"))
    design.drawing.gradient((0, 0), (0, 4), 0.5, 2.0)
    design.terrain.paint(3, 3, 5)
    id = store.add(design)
    other = store.add(design)
    assert id != other
    assert store.load(id).record() == design.record()
    assert Design.read(json.dumps(design.record())).record() == design.record()
    assert {entry.name for entry in store.entries()} == {"Räd <b>bot</b>"}
    assert Design.read("HHH\nV.V").drawing.text == "HHH/V.V"
    assert Design.read("Walk_Bot").name == "Walk_Bot"
    store.delete(id)
    assert [entry.id for entry in store.entries()] == [other]
    assert len(list((store.folder / "deleted").iterdir())) == 1


def test_files_that_somebody_brings_are_designs_or_bodies():
    body = Body("HHH/V.V")
    arrays, array = io.BytesIO(), io.BytesIO()
    np.savez(arrays, body.grid, body.connections)
    np.save(array, body.grid)
    tool = json.dumps(World(3, 2, (WorldObject("robot", body.grid, (0, 0)),)).to_design_tool())
    for name, content in (
        ("my  ant.npz", arrays.getvalue()),
        ("my ant.NPY", array.getvalue()),
        ("my ant.txt", b"333\n404\n"),
        ("my ant.json", tool.encode()),
        ("x.json", b'{"name": "my ant", "design": {"body": "HHH/V.V"}}'),
    ):
        design = Design.read_file(name, content)
        assert (design.name, design.drawing.text) == ("my ant", "HHH/V.V")
    for name, content in (("a.npz", b"PK"), ("a.npy", b""), ("a.json", b"\xff"), ("a.exe", b"H"), ("a.txt", b"X" * 99)):
        with pytest.raises(ValueError):  # noqa: PT011  (each says something else)
            Design.read_file(name, content)


@pytest.mark.parametrize(
    "id",
    ["", "..", ".", "../x", "a/b", "a\\b", "/etc/passwd", "a.json", "A", "-a", "a" * 41, "a\0", "a\n", "ä", None, 3],
)
def test_no_name_leads_out_of_the_folder(store, id):
    for use in (store.load, store.runs, store.delete, lambda id: store.save(id, {})):
        with pytest.raises(ValueError, match="design: got the id"):
            use(id)


def test_links_lead_nowhere(store, tmp_path):
    secret = tmp_path / "secret.json"
    secret.write_text(json.dumps(Design().record()))
    (store.folder / "designs" / "linked.json").symlink_to(secret)
    (store.folder / "runs" / "linked").symlink_to(tmp_path)
    for use in (store.load, store.runs, lambda id: store.save(id, Design().record())):
        with pytest.raises(ValueError, match="out of the folder"):
            use("linked")
    assert store.entries() == []


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "not JSON"),
        ("[1]", "cells"),
        ('{"design": 3}', "expected an object"),
        ('{"design": {"body": "HHX"}}', "allowed characters"),
        ('{"design": {"body": "HH", "stiffness": "9"}}', "0.5 to 2"),
        ('{"design": {"body": "HH"}, "task": "../x"}', "task"),
        ('{"design": {"body": "HH"}, "name": "a\\u0000b"}', "name"),
        ('{"design": {"body": "HH"}, "material": "wood"}', "material"),
        ('{"design": {"body": "HH"}, "terrain": {"cells": "F"}}', "size"),
        ('{"design": {"body": "HH"}, "more": 1}', "more"),
        ("{" * 100_000, "not JSON"),
        (" " * 300_000, "bytes"),
    ],
)
def test_a_broken_file_is_told_and_left_out(store, content, words):
    (store.folder / "designs" / "broken.json").write_text(content)
    with pytest.raises(ValueError, match=words):
        store.load("broken")
    assert store.entries() == []
    good = store.add(Design())
    assert [entry.id for entry in store.entries()] == [good]


def test_a_terrain_is_a_file_that_tasks_read(store):
    from evogymcm.envs import walking_task

    design = Design(task=TERRAIN, drawing=Drawing.of("HHH/V.V"))
    path = store.task("mine", design, (2, 3))
    assert walking_task(path).world["ground"].shape == (2, 40)
    design.terrain.paint(9, 10, 5)
    assert walking_task(store.task("mine", design, (2, 3))).world["ground"].shape == (3, 40)
    assert store.task("mine", Design(), (2, 3)) == "Walker-v0"


def test_a_full_disk_loses_no_design(store, monkeypatch):
    id = store.add(Design("Kept"))
    studio = Studio(store)
    session = studio.open(id)
    assert studio.open(id) is session
    before = (store.folder / "designs" / f"{id}.json").read_bytes()

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        patch.setattr(sessions, "_RETRY", 0.5)
        session.design.drawing.write("HHH/V.V")
        session.changed()
        wait_for(lambda: session.unsaved is not None)
        assert "space" in session.unsaved
        assert not session.is_saved
        assert (store.folder / "designs" / f"{id}.json").read_bytes() == before
        wait_for(lambda: not list((store.folder / "designs").glob(".*")))  # nothing half written takes room
    wait_for(lambda: session.is_saved)  # there is room again: nobody has to do anything
    assert session.unsaved is None
    assert store.load(id).drawing.text == "HHH/V.V"
    studio.close()


def test_what_was_drawn_last_is_kept_when_the_studio_ends(store):
    id = store.add(Design())
    studio = Studio(store)
    studio.open(id).design.drawing.write("HV")
    studio.open(id).changed()
    studio.close()
    assert Studio(store).open(id).design.drawing.text == "HV"


def test_a_folder_that_is_a_file_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="cannot be used"):
        Store(tmp_path / "file")
