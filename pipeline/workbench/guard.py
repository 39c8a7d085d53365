"""Access control of the workbench: only a browser that opened the address with the secret token may send requests.

Another web page in the same browser could send requests to this server too. They are refused: such a page does not know
the token, the browser does not send the cookie with its requests (``SameSite=Strict``) and names the page's address
(``Origin``). A host name that another page directs to this computer (DNS rebinding) is not among the allowed ones
(``Host``).
"""

import ipaddress
import secrets
from collections.abc import Awaitable, Callable, Collection, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from urdf.bounds import MAX_UPLOAD_BYTES

AsgiMessage = MutableMapping[str, Any]
ReceiveFunction = Callable[[], Awaitable[AsgiMessage]]
SendFunction = Callable[[AsgiMessage], Awaitable[None]]
AsgiApplication = Callable[[AsgiMessage, ReceiveFunction, SendFunction], Awaitable[None]]

TOKEN_FIELD = "token"
"""Name of the token in the query of the page's address."""
HTTP_FORBIDDEN, HTTP_TOO_LARGE = 403, 413
WEBSOCKET_POLICY_VIOLATION = 1008
"""Code with which a refused websocket is closed: policy violation (RFC 6455, section 7.4.1)."""


class AccessGuard:
    """ASGI application that passes allowed requests and websockets to another application, and refuses all others.

    Args:
        application: protected ASGI application.
        port: port on which the server listens.
        names: allowed host names of this server; numeric addresses are always allowed.

    Attributes:
        token: secret that the address must contain.
    """

    def __init__(self, application: AsgiApplication, port: int, names: Collection[str]) -> None:
        self._application, self._names = application, frozenset(name.lower() for name in names)
        self.token = secrets.token_urlsafe(24)
        self._cookie = f"armdyn-{port}"  # cookies are shared by all ports of a host

    async def __call__(self, scope: AsgiMessage, receive: ReceiveFunction, send: SendFunction) -> None:
        """Handle one ASGI connection: pass it to the application, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._application(scope, receive, send)
            return
        headers = [(name.decode("latin-1").lower(), value.decode("latin-1")) for name, value in scope["headers"]]
        sent = dict(headers)
        asked = parse_qs(scope.get("query_string", b"").decode("latin-1")).get(TOKEN_FIELD, [""])[0]
        why = self._refusal(sent, asked)
        size = sent.get("content-length", "0")
        if why is not None:
            await self._refuse(scope, receive, send, HTTP_FORBIDDEN, why)
        elif not size.isdecimal() or int(size) > MAX_UPLOAD_BYTES:
            await self._refuse(scope, receive, send, HTTP_TOO_LARGE, f"at most {MAX_UPLOAD_BYTES / 2**20:g} MiB")
        else:
            await self._application(scope, _bounded(receive), self._with_cookie(send) if asked else send)

    def _refusal(self, sent: dict[str, str], asked: str) -> str | None:
        host = sent.get("host", "")
        if not self._ours(host):
            return "this workbench is not called so"
        origin = sent.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return "another page asks"
        if sent.get("sec-fetch-site") == "cross-site" and not asked:
            return "another page asks"
        try:
            cookie = SimpleCookie(sent.get("cookie", "")).get(self._cookie)
        except CookieError:
            cookie = None
        known = [asked, cookie.value if cookie is not None else ""]
        if not any(secrets.compare_digest(each.encode(), self.token.encode()) for each in known):
            return "open the address that 'armdyn workbench' printed, with its token"
        return None

    def _ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name.lower() in self._names
        return True

    def _with_cookie(self, send: SendFunction) -> SendFunction:
        async def sending(message: AsgiMessage) -> None:
            if message["type"] == "http.response.start":
                cookie = f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
                message["headers"] = [*message.get("headers", ()), (b"set-cookie", cookie.encode()),
                                      (b"referrer-policy", b"no-referrer")]  # fmt: skip
            await send(message)

        return sending

    @staticmethod
    async def _refuse(scope: AsgiMessage, receive: ReceiveFunction, send: SendFunction, status: int, why: str) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": WEBSOCKET_POLICY_VIOLATION, "reason": why})
            return
        said = f"armdyn workbench: {why}\n".encode()
        headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close")]
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": said})


def _bounded(receive: ReceiveFunction) -> ReceiveFunction:
    """ASGI receive function that disconnects a client that sends more than `LARGEST_UPLOAD` bytes."""
    left = MAX_UPLOAD_BYTES

    async def receiving() -> AsgiMessage:
        nonlocal left
        message = await receive()
        if message["type"] == "http.request":
            left -= len(message.get("body", b""))
            if left < 0:
                return {"type": "http.disconnect"}
        return message

    return receiving
