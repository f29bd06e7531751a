"""Who may talk to the studio: tests of host, origin, path and key, as a second person on the machine would try."""

import asyncio

import pytest

from evogymcm.studio.access import Access, load_key

KEY, PORT = "k" * 43, 8420
HOST, COOKIE = b"127.0.0.1:8420", f"other=1; evogymcm-studio-{PORT}={KEY}".encode()


def ask(headers=(), *, path="/d/robot", query=b"", kind="http", method="GET", raw=None):
    """Returns status and headers of the answer, of a websocket the code that closes it or "in" where it got through."""
    sent, reached = [], []

    async def app(scope, receive, send):
        reached.append(scope)
        if scope["type"] == "http":
            await send({"type": "http.response.start", "status": 200, "headers": []})
            await send({"type": "http.response.body", "body": b"secret"})

    async def receive():
        return {"type": f"{kind}.connect"}

    async def send(message):
        sent.append(message)

    raw = path.encode() if raw is None else raw
    scope = {"type": kind, "path": path, "raw_path": raw, "query_string": query, "headers": list(headers)}
    asyncio.run(Access(app, PORT, KEY)(scope | ({"method": method} if kind == "http" else {}), receive, send))
    if kind == "websocket":
        return "in" if reached else sent[0]["code"]
    assert bool(reached) == (sent[0]["status"] == 200)
    assert b"secret" not in b"".join(message.get("body", b"") for message in sent) or reached
    return sent[0]["status"], dict(sent[0]["headers"])


def browser(**changes):
    """Returns the headers of a browser with the cookie, some of them changed or left out (None)."""
    headers = {"host": HOST, "cookie": COOKIE, "origin": b"http://127.0.0.1:8420"}
    headers |= {name.replace("_", "-"): value for name, value in changes.items()}
    return [(name.encode(), value) for name, value in headers.items() if value is not None]


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_the_own_page_gets_through(kind):
    for headers in (
        browser(),
        browser(origin=None),
        browser(host=b"localhost:8420", origin=b"http://localhost:8420"),
        browser(sec_fetch_site=b"same-origin"),
    ):
        answer = ask(headers, kind=kind)
        assert (answer if kind == "websocket" else answer[0]) == ("in" if kind == "websocket" else 200)


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    ("headers", "status"),
    [
        (browser(host=b"evil.example"), 400),
        (browser(host=b"evil.example:8420"), 400),
        (browser(host=b"127.0.0.1:8421"), 400),
        (browser(host=b"127.0.0.1"), 400),
        (browser(host=b"127.0.0.1.nip.io:8420"), 400),
        (browser(host=b"192.168.0.7:8420"), 400),
        (browser(host=None), 400),
        ([*browser(), (b"host", HOST)], 400),
        (browser(origin=b"http://evil.example"), 403),
        (browser(origin=b"http://127.0.0.1:9000"), 403),
        (browser(origin=b"http://localhost:8420"), 403),
        (browser(origin=b"https://127.0.0.1:8420"), 403),
        (browser(origin=b"null"), 403),
        (browser(origin=b""), 403),
        (browser(origin=None, sec_fetch_site=b"cross-site"), 403),
        (browser(origin=None, sec_fetch_site=b"same-site", sec_fetch_mode=b"no-cors"), 403),
        (browser(cookie=None), 401),
        (browser(cookie=b"evogymcm-studio-8420="), 401),
        (browser(cookie=b"evogymcm-studio-8420=" + b"x" * 43), 401),
        (browser(cookie=b"evogymcm-studio-8421=" + KEY.encode()), 401),
        (browser(cookie=b"\xff\xfe=;;="), 401),
    ],
)
def test_others_do_not(kind, headers, status):
    answer = ask(headers, kind=kind)
    assert (answer if kind == "websocket" else answer[0]) == (1008 if kind == "websocket" else status)


@pytest.mark.parametrize(
    "path",
    [
        "/../etc/passwd",
        "/d/..",
        "/d/%2e%2e/x",
        "/d/%2E./x",
        "/d/%252e%252e/x",
        "/d/..%2f..%2fetc",
        "/d/..%5c..",
        "/d/..\\x",
        "/d/./x",
        "/d/%00",
        "/~root",
        "/d/%25252525252e",
    ],
)
def test_no_path_leads_upwards(path):
    assert ask(browser(), path=path)[0] == 400
    assert ask(browser(), path=path, kind="websocket") == 1008


def test_the_address_opens_it_once_and_leaves_a_cookie():
    visit = [(b"host", HOST), (b"sec-fetch-site", b"cross-site"), (b"sec-fetch-mode", b"navigate")]
    status, headers = ask(visit, path="/open", query=f"key={KEY}&design=%7B%22".encode())
    assert (status, headers[b"location"]) == (303, b"/open?design=%7B%22")
    cookie = headers[b"set-cookie"]
    assert b"HttpOnly" in cookie
    assert b"SameSite=Lax" in cookie
    assert ask([(b"host", HOST), (b"cookie", cookie.split(b";")[0])])[0] == 200
    assert ask(visit, path="//evil.example", query=f"key={KEY}".encode())[1][b"location"] == b"/evil.example"
    assert ask(visit, query=b"key=wrong")[0] == 401
    assert ask([(b"host", HOST)], method="POST", query=f"key={KEY}".encode())[0] == 401
    assert ask(browser(host=b"evil.example"), query=f"key={KEY}".encode())[0] == 400
    for answer in (ask(browser()), ask([])):
        assert answer[1][b"x-frame-options"] == b"DENY"


def test_the_key_is_kept_for_its_user_alone(tmp_path):
    key = load_key(tmp_path)
    assert len(key) >= 43
    assert load_key(tmp_path) == key
    path = tmp_path / "key"
    assert path.stat().st_mode & 0o077 == 0
    path.chmod(0o644)
    load_key(tmp_path)
    assert path.stat().st_mode & 0o077 == 0
