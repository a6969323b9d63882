"""Who may come in: told by the request alone. What a browser may be tricked into must not get through.

A page of somebody else's may send its visitors' browsers here: such requests have another `Origin`, and
after a name was pointed at us (DNS rebinding), another `Host`. Both are refused, also where only this machine
itself can connect.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

from flying_vines.gateway import page_token

LONGEST_TOKEN = page_token.LONGEST + 64
"""As typed, with spaces and hyphens."""
_HOST = re.compile(r"[A-Za-z0-9.-]+(:\d{1,5})?|\[[0-9A-Fa-f:.]+\](:\d{1,5})?")


@dataclass(frozen=True, slots=True)
class Admitted:
    """Somebody who may look, and perhaps ask. `token` is to be remembered by the browser, if it is new."""

    may_ask: bool
    token: str = ""


@dataclass(frozen=True, slots=True)
class Turned:
    """Away, with an HTTP status and a sentence."""

    status: int
    why: str


class Door:
    """Of a page that is served at `host`, an address; beyond this machine only with the `token`."""

    def __init__(self, host: str, port: int, token: str) -> None:
        self._local = ipaddress.ip_address(host).is_loopback
        if not self._local and not token:
            raise ValueError("a page for the network needs a token")
        self._token = token
        self._watching = page_token.watching(token) if token else ""
        # Browsers do not tell ports apart here.
        self.cookie = f"flying-vines-{port}"
        name = socket.gethostname().lower()
        self._names = {"localhost"} if self._local else {"localhost", name, f"{name}.local"}

    def look(
        self, headers: Mapping[str, str], given: str = "", cookies: Mapping[str, str] | None = None
    ) -> Admitted | Turned:
        """`headers` are a request's, by names of any case; `given` is the token in its address."""
        host = headers.get("Host", "")
        if not self._ours(host):
            return Turned(421, "that is not a name of this page: open it by its address")
        origin = headers.get("Origin")
        if origin is not None and origin.lower().partition("://")[2] != host.lower():
            return Turned(403, "another site's page may not ask for this")
        if headers.get("Sec-Fetch-Site") in ("cross-site", "same-site") and (
            headers.get("Sec-Fetch-Mode") != "navigate"
        ):
            return Turned(403, "another site's page may not ask for this")
        if self._local:
            return Admitted(may_ask=True)
        for token in (given, self._bearer(headers), (cookies or {}).get(self.cookie, "")):
            if not 0 < len(token) <= LONGEST_TOKEN:
                continue
            if page_token.same(token, self._token):
                return Admitted(may_ask=True, token=self._token)
            if page_token.same(token, self._watching):
                return Admitted(may_ask=False, token=self._watching)
        return Turned(401, "that token is not right" if given else "the page needs its token")

    def _ours(self, host: str) -> bool:
        """Names can be pointed at us by others; addresses cannot."""
        if not _HOST.fullmatch(host):
            return False
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name in self._names:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return address.is_loopback or not self._local

    def _bearer(self, headers: Mapping[str, str]) -> str:
        kind, _, token = headers.get("Authorization", "").partition(" ")
        return token if kind.lower() == "bearer" else ""
