"""Who may talk to the server, and what browsers may do with its answers.

A server on 127.0.0.1 can be reached by every page that is open in a browser on the machine: by name, if the owner of a
domain lets it point here (DNS rebinding), and blindly, by requests from other sites. So the name in ``Host`` must be
one of ours, and the site that a browser names in ``Origin`` must be ours too. A server for other machines asks for a
token.
"""

from __future__ import annotations

import hmac
import ipaddress
import socket
from dataclasses import dataclass
from http.cookies import SimpleCookie
from urllib.parse import parse_qs, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

COOKIE = "genmf_token"
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
REPORT_POLICY = (
    "sandbox allow-scripts; default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""A report is a page of its own with scripts inside; in a sandbox it can ask nothing of the server."""
HEADERS = {
    "Content-Security-Policy": PAGE_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_SAFE = ("GET", "HEAD", "OPTIONS")


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


@dataclass(frozen=True)
class Guard:
    """Lets through what may pass, and adds the security headers.

    host: the address that the server listens on. token: what others must know; None asks for none.
    """

    app: ASGIApp
    host: str = "127.0.0.1"
    token: str | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """As ASGI has it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        refused = self._refused(scope)

        async def secured(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await (refused or self.app)(scope, receive, secured)

    def _refused(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        if not self._is_ours(headers.get("host", "")):
            return error(421, "host", "this server does not answer to that name. Use the address that it has printed.")
        site, origin = headers.get("sec-fetch-site", "none"), headers.get("origin")
        foreign = origin is not None and urlsplit(origin).netloc.lower() != headers.get("host", "").lower()
        if foreign or (site not in ("none", "same-origin") and not self._is_navigation(scope, headers)):
            return error(403, "origin", "requests from other sites are refused.")
        return self._without_token(scope, headers) if self.token else None

    def _is_ours(self, name: str) -> bool:
        """Whether a name in ``Host`` is one that nobody else can let point to this machine."""
        host = (urlsplit(f"//{name}").hostname or "") if name else ""
        if is_loopback(self.host):
            return is_loopback(host)
        try:
            ipaddress.ip_address(host)
            return True
        except ValueError:
            own = socket.gethostname().lower()
            return host.lower() in ("localhost", own, f"{own}.local", self.host.lower())

    @staticmethod
    def _is_navigation(scope: Scope, headers: Headers) -> bool:
        """Whether somebody follows a link to the page, which shows nothing to the site that the link is on."""
        return scope["method"] in _SAFE and headers.get("sec-fetch-mode") == "navigate" and scope["path"] == "/"

    def _without_token(self, scope: Scope, headers: Headers) -> Response | None:
        assert self.token is not None
        cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        bearer = headers.get("authorization", "").removeprefix("Bearer ")
        query = parse_qs(scope["query_string"].decode("latin-1"))
        (given,) = query.get("token", [""])[:1]
        if scope["path"] == "/" and given and self._is_token(given):
            rest = urlencode({name: values for name, values in query.items() if name != "token"}, doseq=True)
            response = RedirectResponse("/" + (f"?{rest}" if rest else ""), status_code=303)
            response.set_cookie(COOKIE, given, httponly=True, samesite="strict", max_age=30 * 24 * 3600)
            return response
        if self._is_token(bearer) or (cookie and self._is_token(cookie.value)):
            return None
        return error(401, "token", "this server asks for a token: open the whole address that it has printed.")

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), (self.token or "").encode())


def error(status: int, code: str, message: str) -> JSONResponse:
    """An answer that says what is wrong: a ``code`` for programs and translations, and a sentence."""
    return JSONResponse({"error": {"code": code, "message": message}}, status_code=status)
