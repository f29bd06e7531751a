"""The studio's server: one process, on this machine only."""

import html
import logging
import os
import socket
import threading
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from evogymcm._extras import load_extra
from evogymcm._files import write_atomic
from evogymcm.studio.access import HOST, KEY, Access, load_key
from evogymcm.studio.sessions import Studio
from evogymcm.studio.store import Store

_GRACE = 2  # seconds that open connections have when the server ends


def serve(
    folder: str | os.PathLike[str],
    port: int,
    *,
    policies: Sequence[str | os.PathLike[str]] = (),
    show: bool,
    tell: Callable[[str], None],
) -> None:
    """Serves the studio of a folder until it is interrupted.

    Args:
        folder: Where designs are kept.
        port: To listen on, at 127.0.0.1; 0 takes a free one.
        policies: Folders of runs elsewhere whose policies may be used too.
        show: Whether to open a browser.
        tell: Called with the address, which holds the key, once the server listens.

    Raises:
        ImportError: NiceGUI is not installed.
        ValueError: The folder or the port cannot be used, another studio has the folder open, or a run is missing.
    """
    os.environ.setdefault("NICEGUI_STORAGE_PATH", str(Path(folder).expanduser().resolve() / ".nicegui"))
    load_extra("nicegui", "the studio needs NiceGUI, which cannot be imported", "studio")
    store = Store(folder)
    lock = FileLock(store.folder / "lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise ValueError(f"folder: another studio has {store.folder} open; end it, or choose another folder") from None
    with lock, _listen(port) as listening:
        number = listening.getsockname()[1]
        key = load_key(store.folder)
        address = f"http://{HOST}:{number}/?{KEY}={key}"
        studio = Studio(store, policies)
        try:
            server = _make_server(studio, number, key, lambda: _opened(store.folder, address, show, tell))
            server.run(sockets=[listening])
        finally:
            studio.close()


def _listen(port: int) -> socket.socket:
    """Returns a socket that listens on this machine only."""
    if not 0 <= port < 65536:
        raise ValueError(f"port: got {port}, expected 0 to 65535")
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((HOST, port))
        listening.listen()  # who comes from now on waits for the server
    except OSError as error:
        listening.close()
        raise ValueError(f"port: {port} cannot be used ({error.strerror}); choose another one, or 0 for any") from error
    return listening


def _make_server(studio: Studio, port: int, key: str, opened: Callable[[], None]) -> Any:
    """Returns the server, with nothing in front of `Access`."""
    import uvicorn
    from fastapi import FastAPI
    from nicegui import app, ui

    from evogymcm.studio.page import register
    from evogymcm.studio.page.theme import ICON

    outer = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    register(studio)
    app.on_startup(opened)
    ui.run_with(outer, title="evogymcm studio", favicon=ICON, show_welcome_message=False, reconnect_timeout=20.0)
    logging.getLogger("uvicorn.error").setLevel(logging.WARNING)
    options: dict[str, Any] = {
        "log_level": "warning",
        "access_log": False,
        "timeout_graceful_shutdown": _GRACE,
        "server_header": False,
    }
    return uvicorn.Server(uvicorn.Config(Access(outer, port, key), **options))


def _opened(folder: Path, address: str, show: bool, tell: Callable[[str], None]) -> None:
    """Says where the studio is, and opens a browser.

    The browser gets a file that only the user can read, and that leads to the address: what programs are started with
    can be seen by everyone on the machine, and the key must not.
    """
    tell(address)
    if not show:
        return
    path = folder / "open.html"
    there = f'<meta http-equiv="refresh" content="0;url={html.escape(address)}">'
    page = f"<!DOCTYPE html>{there}<title>evogymcm studio</title>"

    def write(part: Path) -> None:
        part.touch(0o600)
        part.chmod(0o600)
        part.write_text(page, encoding="utf-8")

    write_atomic(path, write)
    threading.Thread(target=webbrowser.open, args=(path.as_uri(),), daemon=True).start()  # some wait for their end
