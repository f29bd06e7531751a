"""Who may talk to the studio: one person's browser on this machine, and no page of another origin."""

import hmac
import secrets
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, unquote

from evogymcm._files import write_atomic

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

HOST = "127.0.0.1"
KEY = "key"  # the parameter of the address that opens the studio
_YEAR = 365 * 24 * 3600
# What every answer says: nobody may frame the page, and browsers tell no other site its address.
_HEADERS = (
    (b"x-frame-options", b"DENY"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)


class Access:
    """Lets through, to an ASGI app, what a browser with the key asks of its own page; refuses all else.

    A request must name this machine and port as its host, so that no other name can be pointed at the studio; its
    origin, where it has one, must be the studio's own, for websockets too; its path must lead nowhere else; and it must
    carry the key, which other users of the machine cannot read: as a cookie, or once in the address of a page, which
    sets the cookie.

    Args:
        app: The app.
        port: The port it listens on.
        key: What only its user knows.
    """

    def __init__(self, app: App, port: int, key: str) -> None:
        self._app, self._key = app, key
        self._hosts = [f"{name}:{port}" for name in (HOST, "localhost")]
        self._cookie = f"evogymcm-studio-{port}"  # cookies know no ports

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answers a request, or hands it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        problem = self._problem(scope)
        if problem is not None:
            await _refuse(scope, receive, send, *problem)
        elif scope["type"] == "http" and _given_key(scope) is not None:
            await self._let_in(scope, send)
        else:
            await self._app(scope, receive, _with_headers(send))

    def _problem(self, scope: Scope) -> tuple[int, str] | None:
        """Returns the status and the reason to refuse a request, None to let it through."""
        headers = scope["headers"]
        hosts, origins = _values(headers, b"host"), _values(headers, b"origin")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return 400, "the studio answers to its own address only"
        allowed = [f"http://{hosts[0].lower()}"]
        if len(origins) > 1 or [origin.lower() for origin in origins] not in ([], allowed):
            return 403, "pages of other origins may not use the studio"
        sites = _values(headers, b"sec-fetch-site")  # other ports are the same site
        if not set(sites) <= {"same-origin", "none"} and not _is_visit(scope):
            return 403, "pages of other sites may not use the studio"
        if _escapes(scope.get("raw_path") or scope["path"].encode()):
            return 400, "this path leads out of the studio"
        keys = [_given_key(scope), *_cookies(headers, self._cookie)]
        if not any(hmac.compare_digest(given.encode(), self._key.encode()) for given in keys if given is not None):
            return 401, "open the studio by the address that `evogymcm studio` shows"
        return None

    async def _let_in(self, scope: Scope, send: Send) -> None:
        """Sets the cookie and sends the browser to the page without the key in its address."""
        cookie = f"{self._cookie}={self._key}; HttpOnly; SameSite=Lax; Path=/; Max-Age={_YEAR}"
        parts = scope.get("query_string", b"").decode("latin-1").split("&")
        query = "&".join(part for part in parts if not part.startswith(f"{KEY}="))
        target = "/" + quote(scope["path"].lstrip("/")) + (f"?{query}" if query else "")
        headers = [
            (b"location", target.encode("latin-1")),
            (b"set-cookie", cookie.encode()),
            (b"cache-control", b"no-store"),
            *_HEADERS,
        ]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})


def _values(headers: Iterable[tuple[bytes, bytes]], name: bytes) -> list[str]:
    return [value.decode("latin-1").strip() for key, value in headers if key.lower() == name]


def _given_key(scope: Scope) -> str | None:
    """Returns the key in a request's address."""
    query = scope.get("query_string", b"").decode("latin-1")
    return next(iter(parse_qs(query).get(KEY, [])), None) if scope.get("method") == "GET" else None


def _cookies(headers: Iterable[tuple[bytes, bytes]], name: str) -> list[str]:
    found = []
    for line in _values(headers, b"cookie"):
        try:
            cookies = SimpleCookie(line)
        except CookieError:
            continue
        found += [cookies[name].value] if name in cookies else []
    return found


def _is_visit(scope: Scope) -> bool:
    """Returns whether a person follows a link to a page, as from a mail: nothing else of other sites may come in."""
    modes = _values(scope["headers"], b"sec-fetch-mode")
    return scope["type"] == "http" and scope.get("method") == "GET" and modes == ["navigate"]


def _escapes(path: bytes) -> bool:
    """Returns whether a path has parts that lead upwards, however often they are quoted."""
    text = path.decode("latin-1")
    for _ in range(4):
        parts = text.replace("\\", "/").split("/")
        if ".." in parts or "." in parts or "\0" in text or any(part.startswith("~") for part in parts):
            return True
        quoted, text = text, unquote(text, "latin-1")
        if quoted == text:
            return False
    return True


def _with_headers(send: Send) -> Send:
    async def sending(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", []), *_HEADERS]}
        await send(message)

    return sending


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": reason})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), *_HEADERS]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": f"evogymcm studio: {reason}\n".encode()})


def load_key(folder: Path) -> str:
    """Returns the key of a folder, made at first, which only its user can read; so pages outlive the server."""
    path = folder / "key"
    if path.is_file():
        path.chmod(0o600)
        key = path.read_text(encoding="ascii").strip()
        if len(key) >= 32:
            return key
    key = secrets.token_urlsafe(32)

    def write(part: Path) -> None:
        part.touch(0o600)
        part.chmod(0o600)
        part.write_text(key, encoding="ascii")

    write_atomic(path, write)
    return key
