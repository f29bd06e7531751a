"""The studio as a process: what others on the machine can do with its port, and what outlives it."""

import json
import socket
import sys

import pytest

from evogymcm.__main__ import main
from evogymcm.studio.store import Design, Store
from tests.studio.server import serving

UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec_WebSocket_Version": "13",
    "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
}
SOCKETS = ("/_nicegui_ws/socket.io/?EIO=4&transport=websocket", "/live/robot", "/pair/robot/robot/0")


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A studio that has one design; the last test kills it."""
    folder = tmp_path_factory.mktemp("studio")
    id = Store(folder).add(Design("Robot"))
    with serving(folder) as started:
        started.folder, started.id = folder, id
        yield started


def test_another_person_on_the_machine_can_do_nothing_with_the_port(server, tmp_path, capsys):
    id = server.id
    own = f"http://127.0.0.1:{server.port}"
    page = server.ask(f"/d/{id}")
    assert page[0] == 200
    assert "X-Frame-Options".lower() in {name.lower() for name in page[1]}
    visit = server.ask(f"/?key={server.key}", Cookie=None)
    assert (visit[0], visit[1]["location"]) == (303, "/")
    static = next(part for part in page[2].decode().split('"') if "/static/" in part and part.endswith(".js"))
    for path in ("/", f"/d/{id}", "/designs", "/open", static, "/favicon.ico", "/_nicegui_ws/socket.io/?EIO=4"):
        for method in ("GET", "POST", "PUT", "DELETE", "OPTIONS", "HEAD"):
            assert server.ask(path, method, Cookie=None)[0] == 401, (method, path)
        assert server.ask(path, host=f"evil.example:{server.port}")[0] == 400
        assert server.ask(path, Origin="http://evil.example")[0] == 403
        assert server.ask(path, "POST", Origin="http://evil.example")[0] == 403
    for path in (f"{static}/../../../../etc/passwd", "/d/..%2f..%2fkey", "/%2e%2e/key", "/d/../key"):
        assert server.ask(path)[0] == 400
    for path in SOCKETS:
        assert server.ask(path, **UPGRADE, Origin=own)[0] == 101
        for wrong in ({"Cookie": None}, {"Origin": "http://evil.example"}, {"host": "evil.example"}):
            assert server.ask(path, **UPGRADE | {"Origin": own} | wrong)[0] == 403
    with pytest.raises(OSError), socket.create_connection(("127.0.0.2", server.port), timeout=5):  # noqa: PT011
        pass  # it listens at one address of this machine
    for name in ("key",):
        assert (server.folder / name).stat().st_mode & 0o077 == 0
    for arguments, words in (
        ([str(server.folder)], "another studio"),
        ([str(tmp_path / "b"), "--port", str(server.port)], "port"),
    ):
        with pytest.raises(SystemExit) as stop:
            main(["studio", *arguments, "--no-browser"])
        assert stop.value.code == 2
        assert words in capsys.readouterr().err


def test_without_its_package_it_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "nicegui", None)
    with pytest.raises(SystemExit) as stop:
        main(["studio", str(tmp_path / "robots")])
    assert stop.value.code == 2
    assert "evogymcm[studio]" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_studio_that_was_killed_comes_back_with_its_key_and_designs(server):
    assert server.ask(f"/d/{server.id}")[0] == 200
    server.kill()
    with serving(server.folder, server.port) as again:
        assert again.key == server.key
        assert again.ask(f"/d/{server.id}", Cookie=server.cookie)[0] == 200
    assert again.process.returncode in (0, 130)
    assert json.loads((server.folder / "designs" / f"{server.id}.json").read_text())["name"] == "Robot"
