"""Refuses requests that the page itself does not make, before anything else sees them.

A server on one's own computer can be reached by every web page that the browser shows:
by its address, or by a name that a stranger's name server points here (DNS rebinding).
So the Host must be one that the command printed, and what changes anything must come
from the page's own origin, as JSON of limited size. Outside this computer a token, which
the command prints, becomes a cookie of the browser.
"""

import hmac
import re
from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import parse_qs

from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_BYTES: Final = 16_384  #: bytes of a request's body, and of its path with the query
MAX_PATH_CHARACTERS: Final = 512
COOKIE: Final = "oed_token"
SAFE: Final = ("GET", "HEAD")
#: what a browser may do with an answer; the page adds the digest of its script
POLICY: Final = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; connect-src 'self';"
    " form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS: Final = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
_NAME: Final = re.compile(r"[A-Za-z0-9.:\[\]-]{1,255}")


class Guard:
    """The application behind checks of host, origin, token and size.

    hosts  what the Host header may be, port included
    token  that every request needs as a cookie; empty on this computer alone
    """

    def __init__(self, app: ASGIApp, hosts: frozenset[str], token: str = "") -> None:
        self.app, self.hosts, self.token = app, hosts, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        headers = _headers(scope)
        refusal = self._refusal(scope, headers)
        if refusal is None and scope["method"] not in SAFE:
            body = await _body(receive)
            if body is None:
                refusal = _refused(413, "the request is too large")
            else:
                receive = _replay(body, receive)
        sent = _add_headers(send)
        await (refusal or self.app)(scope, receive, sent)

    def _refusal(self, scope: Scope, headers: dict[str, list[str]]) -> Response | None:
        """The answer to a request that is refused by its head."""
        host = headers.get("host", [])
        if len(host) != 1 or host[0].lower() not in self.hosts:
            return _refused(421, "this page has another address")
        path = scope.get("raw_path") or scope["path"].encode()
        if len(path) + len(scope["query_string"]) > MAX_PATH_CHARACTERS:
            return _refused(414, "the address is too long")
        site = headers.get("sec-fetch-site", ["none"])[0]
        if scope["method"] in SAFE:
            navigates = headers.get("sec-fetch-mode", [""])[0] == "navigate"
            if site not in ("none", "same-origin") and not navigates:
                return _refused(403, "another page asked")
        elif headers.get("origin") != [f"http://{host[0]}"] or site not in (
            "none",
            "same-origin",
        ):
            return _refused(403, "another page asked")
        elif headers.get("content-type", [""])[0].split(";")[0] != "application/json":
            return _refused(415, "the page sends JSON")
        return self._answer_without_token(scope, headers)

    def _answer_without_token(
        self, scope: Scope, headers: dict[str, list[str]]
    ) -> Response | None:
        """None for a request with the token; the token's link sets the cookie."""
        if not self.token:
            return None
        if self._matches(_cookie(headers)):
            return None
        query = scope["query_string"].decode("latin-1")
        sent_token = parse_qs(query).get("token", [""])[0]
        if scope["method"] == "GET" and self._matches(sent_token):
            answer = RedirectResponse("/", status_code=303)
            answer.set_cookie(COOKIE, self.token, httponly=True, samesite="strict")
            return answer
        return _refused(401, "open the address that `oed serve` printed")

    def _matches(self, word: str) -> bool:
        return hmac.compare_digest(word.encode(), self.token.encode())


def _headers(scope: Scope) -> dict[str, list[str]]:
    headers: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        headers.setdefault(name.decode("latin-1").lower(), []).append(
            value.decode("latin-1")
        )
    return headers


def _cookie(headers: dict[str, list[str]]) -> str:
    try:
        cookies = SimpleCookie("; ".join(headers.get("cookie", [])))
    except CookieError:
        return ""
    return cookies[COOKIE].value if COOKIE in cookies else ""


async def _body(receive: Receive) -> bytes | None:
    """The body of a request; None where it is too large."""
    body = b""
    while True:
        message = await receive()
        if message["type"] != "http.request":
            return None
        body += bytes(message.get("body", b""))
        if len(body) > MAX_BYTES:
            return None
        if not message.get("more_body", False):
            return body


def _replay(body: bytes, receive: Receive) -> Receive:
    messages = iter([{"type": "http.request", "body": body, "more_body": False}])

    async def replay() -> Message:
        message = next(messages, None)
        return await receive() if message is None else message

    return replay


def _add_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            present = {name.lower() for name, _ in message["headers"]}
            policy = (b"content-security-policy", POLICY.encode())
            new = [h for h in (*HEADERS, policy) if h[0] not in present]
            message = {**message, "headers": [*message["headers"], *new]}
        await send(message)

    return sent


def _refused(status: int, why: str) -> Response:
    return PlainTextResponse(f"Refused: {why}.\n", status_code=status)


def hosts_of(names: list[str], port: int) -> frozenset[str]:
    """Host headers of a server's names, with its port."""
    plain = [name for name in names if _NAME.fullmatch(name)]
    bracketed = [f"[{n}]" if ":" in n and not n.startswith("[") else n for n in plain]
    return frozenset(f"{name.lower()}:{port}" for name in bracketed)
