"""The pages without a browser: what buttons do, what they say, and what two tabs share."""

import asyncio
import json
import time
from urllib.parse import quote

import httpx
import pytest
from nicegui import Client, ElementFilter, core, ui
from nicegui.testing import User, user_simulation

from evogymcm.studio.drawing import Drawing
from evogymcm.studio.page import register
from evogymcm.studio.sessions import Studio
from evogymcm.studio.store import TERRAIN, Design, Store

PATIENCE = 600  # tenths of a second that a loaded machine may take


@pytest.fixture(name="studio")
def _studio(tmp_path):
    studio = Studio(Store(tmp_path))
    yield studio
    studio.close()


def visit(studio, act):
    """Lets two tabs be used."""

    async def together():
        async with user_simulation() as user:
            register(studio)
            transport = httpx.ASGITransport(core.app)
            async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
                await act(user, User(client))
            Client.page_routes.clear()  # else NiceGUI would make Python forget the package, as the home of its pages

    asyncio.run(together())


def element(user, marker):
    with user:
        return next(iter(ElementFilter(marker=marker)))


async def stroke(user, *cells, erase=False):
    """Draws over cells, as the canvas tells it."""
    for phase, part in (("start", cells[:1]), ("go", cells[1:]), ("end", (cells[0], cells[-1]))):
        event = {"phase": phase, "cells": [list(cell) for cell in part], "erase": erase}
        user.find(marker="grid").trigger("stroke", event)
    await asyncio.sleep(0.02)


async def press(user, marker, pause=0.02):
    user.find(marker=marker).click()
    await asyncio.sleep(pause)


async def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        await asyncio.sleep(0.05)


def test_a_body_is_drawn_painted_and_kept(studio):
    id = studio.store.add(Design(drawing=Drawing.blank(2, 3)))

    async def act(user, other):
        await user.open(f"/d/{id}")
        await other.open(f"/d/{id}")
        drawing = studio.open(id).design.drawing
        await user.should_see("Nothing is drawn yet.")
        await stroke(user, (0, 0), (0, 1), (0, 2))
        await user.should_see("A body: 3 voxels, 3 actuators.")
        await press(user, "brush-V")
        await stroke(user, (1, 0))
        await stroke(user, (1, 2))
        assert element(user, "text").value == "HHH\nV.V"
        await stroke(user, (0, 1), erase=True)
        await user.should_see("It falls apart: 2 pieces")
        await other.should_see("It falls apart: 2 pieces", retries=PATIENCE)  # the other tab shows the same
        await press(user, "undo")
        await user.should_see("A body: 5 voxels")
        await press(other, "swap_vert")
        assert drawing.text == "V.V/HHH"
        await user.should_see("A body: 5 voxels", retries=PATIENCE)
        user.find(marker="grid").trigger("command", {"name": "brush", "brush": "R"})
        user.find(marker="grid").trigger("command", {"name": "shift", "by": [1, 1]})
        await press(user, "tool-fill")
        await stroke(user, (0, 1))
        assert drawing.text == "VRV/HHH"
        element(user, "text").value = "HHHH/V..V"
        user.find(marker="text").trigger("change")
        assert drawing.text == "HHHH/V..V"
        element(user, "text").value = "HXH"
        user.find(marker="text").trigger("change")
        await user.should_see("allowed characters")
        assert element(user, "text").value == "HHHH\nV..V"
        element(user, "rows").value = 3
        user.find(marker="rows").trigger("change")
        assert drawing.text == "..../HHHH/V..V"
        element(user, "tabs").value = "stiffness"
        element(user, "stiffness").value = 0.5
        await press(user, "tool-brush")
        await stroke(user, (1, 0))
        assert drawing.stiffness_text == "1,1,1,1/0.5,1,1,1/1,1,1,1"
        await press(user, "tool-gradient")
        element(user, "stiffness").value = 2
        await stroke(user, (1, 0), (1, 2))
        assert drawing.stiffness_text == "1,1,1,1/0.5,1,2,2/0.5,1,1,2"
        await user.should_see("stiffness 0.5 to 2")
        await press(user, "undo")
        await press(user, "undo")
        assert not drawing.has_stiffness
        element(user, "name").value = "Ant <script>"
        user.find(marker="name").trigger("change")
        await other.should_see("saved", retries=PATIENCE)

    visit(studio, act)
    studio.save()
    kept = studio.store.load(id)
    assert (kept.drawing.text, kept.name) == ("..../HHHH/V..V", "Ant <script>")


def test_the_robot_is_watched(studio):
    id = studio.store.add(Design(drawing=Drawing.of("HHH/V.V")))

    async def act(user, other):
        await user.open(f"/d/{id}")
        watch = studio.open(id).watch
        await until(lambda: watch.player is not None and not watch.is_busy)
        player = watch.player
        for step in (1, 2):
            await press(user, "step")
            await until(lambda step=step: player.frame()["step"] == step)
        await user.should_see("step 2", retries=PATIENCE)
        element(user, "policy").value = "random"
        element(user, "speed").value = 100
        await until(lambda: not watch.is_busy)
        assert player.speed == 100
        await press(user, "reset")
        await until(lambda: player.frame()["step"] == 0)
        await stroke(user, (1, 0), erase=True)
        await until(lambda: player.frame()["types"].size == 4)
        assert not player.is_playing  # nobody looks on, for the page has no canvas here
        with watch.viewed():
            watch.plays = True
            await until(lambda: player.frame()["step"] > 3)
        assert not player.is_playing
        element(user, "tabs").value = "world"
        await stroke(user, (9, 20), (9, 22))
        element(user, "task").value = TERRAIN
        await until(lambda: watch.player is not player)
        assert watch.player.scene()["terrain"].shape[0] == 82
        await press(user, "tool-fill")
        await stroke(user, (11, 0), erase=True)
        await user.should_see("There is no ground yet")
        element(user, "task").value = "Climber-v0"
        element(user, "material").value = "reactive"
        await until(lambda: watch.player.scene()["task"] == "Climber-v0" and not watch.is_busy)
        assert watch.problem is None

    visit(studio, act)
    studio.save()
    assert (studio.store.load(id).task, studio.store.load(id).material) == ("Climber-v0", "reactive")


def test_designs_begin_are_shared_compared_and_put_away(studio):
    async def act(user, other):
        await user.open("/")
        await until(lambda: user.back_history[-1].startswith("/d/"))
        first = studio.store.entries()[0].id
        await user.should_see("A body: 22 voxels")
        await press(user, "share", 0.2)
        text = element(user, "share-text").value
        assert json.loads(text) == studio.store.load(first).record()
        link = element(user, "link").value
        assert link.startswith("http://test/open?")
        await other.open(link.removeprefix("http://test"))
        assert len(studio.store.entries()) == 1  # looking keeps nothing
        await press(other, "keep")
        await until(lambda: len(studio.store.entries()) == 2)
        await other.open("/open?design=" + quote('{"design": {"body": "HX"}}'))
        await other.should_see("This link holds no design")
        await user.open("/designs")
        await press(user, "new", 0.2)
        element(user, "new-text").value = "HX"
        await press(user, "make")
        await user.should_see("allowed characters")
        element(user, "new-text").value = "HHH/V.V"
        await press(user, "make")
        await until(lambda: len(studio.store.entries()) == 3)
        ids = [entry.id for entry in studio.store.entries()]
        await user.open(f"/compare/{ids[0]}/{ids[1]}")
        pair = studio.pair(ids[0], ids[1])
        await until(lambda: all(watch.player is not None for watch in pair.watches))
        with pair.watches[0].viewed():
            await until(lambda: pair.watches[1].player.frame()["step"] >= 3)
            await press(user, "play", 0.3)
            steps = [watch.player.frame()["step"] for watch in pair.watches]
            assert steps[0] == steps[1]
        for path in (f"/compare/{ids[0]}/nothing", "/d/nothing", "/d/Nothing!"):
            await user.open(path)
            await user.should_see("design: ")
        studio.delete(ids[0])
        await user.open("/designs")
        with user:
            assert len([one for one in ElementFilter(kind=ui.link) if one.props["href"].startswith("/d/")]) == 4

    visit(studio, act)


def test_a_design_that_cannot_be_kept_says_so(studio, monkeypatch):
    id = studio.store.add(Design())

    def full(*_):
        raise OSError(28, "No space left on device")

    async def act(user, other):
        await user.open(f"/d/{id}")
        with monkeypatch.context() as patch:
            patch.setattr("os.fsync", full)
            await stroke(user, (0, 0))
            await user.should_see("NOT SAVED: No space left on device", retries=PATIENCE)
        studio.save()
        await user.should_see("saved", retries=PATIENCE)

    visit(studio, act)
    assert studio.store.load(id).drawing.text.startswith("H")


@pytest.mark.slow
def test_a_policy_is_trained_its_material_improved_and_bodies_evolve(studio):
    id = studio.store.add(Design(drawing=Drawing.of("HHH/V.V")))

    async def act(user, other):
        await user.open(f"/d/{id}")
        session = studio.open(id)
        element(user, "material-rounds").value = 2
        element(user, "learn-tabs").value = "material"
        session.drive("random")
        await press(user, "material-start")
        await user.should_see("It needs the sine gait or a trained policy", retries=PATIENCE)
        element(user, "learn-tabs").value = "train"
        element(user, "train-steps").value = 1000
        await press(user, "train-start")
        await until(lambda: (studio.store.runs(id) / "train-1" / "final.pt").is_file(), 600)
        await until(lambda: "finished" in element(user, "train-status").text)
        assert len(element(user, "train-curve").options["series"][0]["data"]) >= 2
        await other.open(f"/d/{id}")
        await until(lambda: "finished" in element(other, "train-status").text)
        assert session.design.policy == f"{id}/train-1"
        await until(lambda: session.watch.player is not None and not session.watch.is_busy)
        assert session.watch.problem is None
        await press(user, "step", 0.5)
        with pytest.raises(ValueError, match="policy"):
            session.drive(f"../{id}/train-1")
        element(user, "learn-tabs").value = "material"
        await press(user, "material-start")
        await until(lambda: "finished" in element(user, "material-status").text, 600)
        assert "round 2 of 2" in element(user, "material-status").text
        if element(user, "material-use").visible:
            await press(user, "material-use")
            assert session.design.drawing.has_stiffness
        element(user, "learn-tabs").value = "evolve"
        for name, value in (("population", 2), ("budget", 2), ("steps", 1000)):
            element(user, f"evolve-{name}").value = value
        await press(user, "evolve-start")
        with pytest.raises(ValueError, match="running"):
            await until(lambda: studio.runs.check_idle(id))
        await until(lambda: "finished" in element(user, "evolve-status").text, 600)
        nodes = element(user, "evolve-tree").options["series"][0]["data"]
        assert [node["name"] for node in nodes] == ["0", "1"]
        click = {"componentType": "series", "seriesType": "graph", "seriesIndex": 0, "seriesName": "", "dataIndex": 1}
        user.find(marker="evolve-tree").trigger("componentClick", click | {"name": "1", "data": {}, "value": []})
        assert session.design.policy == f"{id}/evolve-1/policy-0001"
        assert session.design.drawing.body().shape == (2, 3)
        await until(lambda: not session.watch.is_busy)
        assert session.watch.problem is None

    visit(studio, act)
    studio.save()  # which otherwise follows in a moment
    again = Studio(studio.store)
    session = again.open(id)
    assert session.wanted().policy.endswith("policy-0001.pt")
    again.delete(id)
    assert not studio.store.runs(id).exists()
    again.close()
