"""Who gets in: whoever has the token of the address, from the page itself, under a name of this computer."""

import asyncio
import http.client
import json
import re
import signal
import socket
import sys
from pathlib import Path

import pytest

from pipeline.workbench.guard import AccessGuard
from urdf.bounds import MAX_UPLOAD_BYTES

from .conftest import workbench

OWN = "127.0.0.1:8080"


async def reached(scope, receive, send):
    """The application: reads everything, and answers."""
    while scope["type"] == "http" and (message := await receive())["type"] == "http.request":
        if not message.get("more_body"):
            break
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
    elif message["type"] == "http.disconnect":
        await send({"type": "gone"})
    else:
        await send({"type": "http.response.start", "status": 200, "headers": []})


@pytest.fixture
def guard():
    return AccessGuard(reached, 8080, ["localhost"])


def asked(guard, headers, query="", kind="http", bodies=(b"",)):
    """Everything that a request or socket is answered with."""
    sent, left = [], [*bodies]

    async def receive():
        if kind == "websocket":
            return {"type": "websocket.connect"}
        body = left.pop(0)
        return {"type": "http.request", "body": body, "more_body": bool(left)}

    async def send(message):
        sent.append(message)

    fields = [(name.encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": kind, "path": "/", "query_string": query.encode(), "headers": fields}
    asyncio.run(guard(scope, receive, send))
    return sent


def is_in(sent):
    return sent[0] == {"type": "websocket.accept"} or sent[0].get("status") == 200


def test_the_token_of_the_address_opens_page_and_socket_and_its_cookie_all_that_follows(guard):
    assert guard.token != AccessGuard(reached, 8080, []).token
    assert len(guard.token) >= 32
    first = asked(guard, {"host": OWN}, f"token={guard.token}")
    assert is_in(first)
    cookie = dict(first[0]["headers"])[b"set-cookie"].decode()
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    own = {"host": OWN, "cookie": cookie.partition(";")[0], "origin": f"http://{OWN}"}
    for kind in ("http", "websocket"):
        assert is_in(asked(guard, own, kind=kind))
        assert is_in(asked(guard, {**own, "host": "localhost:8080", "origin": "http://localhost:8080"}, kind=kind))


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    "wrong",
    [
        {"cookie": ""}, {"cookie": "armdyn-8080="}, {"cookie": "armdyn-8080=abc"}, {"cookie": "armdyn-8081={token}"},
        {"cookie": "armdyn-8080=é"}, {"cookie": "\x00;;==,"}, {"origin": "http://elsewhere.example"},
        {"origin": "null"}, {"origin": "http://127.0.0.1:9999"}, {"host": "elsewhere.example"}, {"host": ""},
        {"host": "elsewhere.example:8080", "origin": "http://elsewhere.example:8080"}, {"host": "[::1"},
        {"host": "127.0.0.1.elsewhere.example:8080"}, {"sec-fetch-site": "cross-site"},
    ],
)  # fmt: skip
def test_nobody_else_gets_in(guard, kind, wrong):
    good = {"host": OWN, "cookie": f"armdyn-8080={guard.token}", "origin": f"http://{OWN}"}
    assert is_in(asked(guard, good, kind=kind))
    sent = asked(guard, {**good, **{key: value.format(token=guard.token) for key, value in wrong.items()}}, kind=kind)
    assert not is_in(sent)
    assert sent[0].get("status", 403) == 403


def test_uploads_are_limited_whether_they_say_their_size_or_not(guard, monkeypatch):
    own = {"host": OWN, "cookie": f"armdyn-8080={guard.token}"}
    for size in (str(MAX_UPLOAD_BYTES + 1), "-1", "many"):
        assert asked(guard, {**own, "content-length": size})[0]["status"] == 413
    monkeypatch.setattr("pipeline.workbench.guard.MAX_UPLOAD_BYTES", 1000)
    assert is_in(asked(guard, own, bodies=[b"x" * 600, b"x" * 400]))
    assert asked(guard, own, bodies=[b"x" * 600, b"x" * 401]) == [{"type": "gone"}]


def answer(address, path, headers=()):
    connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=20)
    connection.request("GET", path, None, dict(headers))
    return connection.getresponse()


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGTERM, 143), pytest.param(signal.SIGHUP, 129, marks=pytest.mark.slow)]
)
def test_a_workbench_lets_its_user_in_and_ends_whatever_is_uploaded(tmp_path, number, status):
    with workbench(tmp_path) as (process, address):
        assert answer(address, "/").status == 403
        page = answer(address, f"/?{address.query}")
        assert page.status == 200
        cookie = page.getheader("set-cookie").partition(";")[0]
        upload_to = re.search(r"/_nicegui/client/[\w-]+/upload/\d+", page.read().decode())[0]
        for path in ("/_nicegui_ws/socket.io/?EIO=4&transport=polling", "/"):
            for wrong in ({}, {"Cookie": cookie, "Origin": "http://elsewhere.example"},
                          {"Cookie": cookie, "Host": f"elsewhere.example:{address.port}"}):  # fmt: skip
                assert answer(address, path, wrong).status == 403
            assert answer(address, path, {"Cookie": cookie}).status != 403
        # A file of 80 MB on its way, that never ends.
        with socket.create_connection(("127.0.0.1", address.port)) as upload:
            head = f"POST {upload_to} HTTP/1.1\r\nHost: 127.0.0.1:{address.port}\r\nCookie: {cookie}\r\n"
            upload.sendall(f"{head}Content-Length: 83886080\r\n\r\n".encode() + bytes(2**20))
            process.send_signal(number)
            process.wait(60)  # about a second; how busy the machine is, is not ours
        out, errors = process.communicate()
        assert process.returncode == status
        assert (out, errors.count("\n")) == ("workbench closed\n", 1)
        assert list((tmp_path / "tmp").iterdir()) == []


def test_a_workbench_of_the_network_says_so_and_wants_its_token_as_well(tmp_path):
    with workbench(tmp_path, "--host", "0.0.0.0", "--json", "a.json") as (process, address):
        assert address.hostname == socket.gethostname()
        assert answer(address, "/").status == 403
        assert answer(address, f"/?{address.query}", {"Host": "elsewhere.example"}).status == 403
        assert answer(address, f"/?{address.query}").status == 200
        assert "token=" in json.loads(Path(tmp_path, "a.json").read_text())["address"]
        process.send_signal(signal.SIGINT)
        assert "warning: --host 0.0.0.0 lets other computers in" in process.communicate(timeout=20)[1]
        assert process.returncode == 0


def test_a_taken_port_a_missing_file_and_a_missing_package_are_one_line(armdyn, tmp_path, monkeypatch):
    pytest.importorskip("nicegui", reason="needs the extra 'workbench': pip install 'armdyn[workbench]'")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        for arguments, hint in (
            (("--port", port, "--no-browser"), f"--port {port}"),
            (("absent.toml",), "no such file"),
        ):
            status, out, errors = armdyn("workbench", *arguments)
            assert (status, out, errors.count("\n")) == (2, "", 1)
            assert hint in errors
    assert list(tmp_path.iterdir()) == []
    for name in [n for n in sys.modules if n.partition(".")[0] == "nicegui" or n.startswith("pipeline.work")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "nicegui", None)
    said = "armdyn: the workbench needs the package 'nicegui': run pip install 'armdyn[workbench]'\n"
    assert armdyn("workbench", "--no-browser") == (2, "", said)
