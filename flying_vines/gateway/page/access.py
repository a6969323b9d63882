"""Decides from the HTTP request who may use the page, and limits the number of connections.

A page of another site can make its visitors' browsers send requests here. Such a request has another `Origin`
or, after DNS rebinding, another `Host`. Both kinds are refused, even if only this computer can connect.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar
from urllib.parse import urlsplit

from flying_vines.gateway import page_token

K = TypeVar("K")

MAX_NEW = 128
"""Maximum number of connections that have not opened the page's socket."""
MAX_VIEWERS = 64
MAX_PILOTS = 16
"""Maximum number of holders of the full token. Viewers do not take these places."""
MAX_TOKEN_LENGTH = page_token.MAX_LENGTH + 64
"""Length of a token as typed, with spaces and hyphens."""
_HOST = re.compile(r"[A-Za-z0-9.-]+(:\d{1,5})?|\[[0-9A-Fa-f:.]+\](:\d{1,5})?")


@dataclass(frozen=True, slots=True)
class Admitted:
    """May watch, and if `may_ask` also send commands. The browser stores `token` in a cookie."""

    may_ask: bool
    token: str = ""


@dataclass(frozen=True, slots=True)
class Refused:
    """An HTTP status and a sentence."""

    status: int
    why: str


class Access:
    """Access to a page at the address `host`. If other computers can reach it, requests need the `token`."""

    def __init__(self, host: str, port: int, token: str) -> None:
        self._local = ipaddress.ip_address(host).is_loopback
        if not self._local and not token:
            raise ValueError("a page for the network needs a token")
        self._token = token
        self._watching = page_token.watching(token) if token else ""
        # Browsers share cookies between ports, so the name has the port.
        self.cookie = f"flying-vines-{port}"
        name = socket.gethostname().lower()
        self._names = {"localhost"} if self._local else {"localhost", name, f"{name}.local"}

    def check(
        self, headers: Mapping[str, str], given: str = "", cookies: Mapping[str, str] | None = None
    ) -> Admitted | Refused:
        """`headers`: of the request, case-insensitive. `given`: the token in the request's address."""
        host = headers.get("Host", "")
        if not self._ours(host):
            return Refused(421, "this host name is not accepted: open the page by its IP address")
        origin = headers.get("Origin")
        if origin is not None and origin.lower().partition("://")[2] != host.lower():
            return Refused(403, "requests from another site's page are refused")
        if headers.get("Sec-Fetch-Site") in ("cross-site", "same-site") and (
            headers.get("Sec-Fetch-Mode") != "navigate"
        ):
            return Refused(403, "requests from another site's page are refused")
        if self._local:
            return Admitted(may_ask=True)
        for token in (given, self._bearer(headers), (cookies or {}).get(self.cookie, "")):
            if not 0 < len(token) <= MAX_TOKEN_LENGTH:
                continue
            if page_token.same(token, self._token):
                return Admitted(may_ask=True, token=self._token)
            if page_token.same(token, self._watching):
                return Admitted(may_ask=False, token=self._watching)
        return Refused(401, "the token is wrong" if given else "the page needs a token")

    def _ours(self, host: str) -> bool:
        """True for our names and for IP addresses: DNS rebinding can fake a name, but not an address.

        If only this computer can connect, the address must be a loopback address.
        """
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


class Connections(Generic[K]):
    """The open connections, by the caller's own keys. A holder of the full token always gets one.

    The caller closes the connection that a method returns, because it has lost its place.
    """

    def __init__(self) -> None:
        self._new: dict[K, str] = {}
        """New connections and their addresses, the oldest first."""
        self._viewers: set[K] = set()
        self._pilots: dict[K, None] = {}
        """The oldest first."""

    def opened(self, who: K, address: str) -> K | None:
        """If there are too many new connections, the address with most of them loses its oldest one."""
        self._new[who] = address
        if len(self._new) <= MAX_NEW:
            return None
        ((busiest, _),) = Counter(self._new.values()).most_common(1)
        oldest = next(key for key, address in self._new.items() if address == busiest)
        del self._new[oldest]
        return oldest

    def add_viewer(self, who: K) -> bool:
        """Returns True if there was a place for the viewer."""
        if len(self._viewers) >= MAX_VIEWERS:
            return False
        self._new.pop(who, None)
        self._viewers.add(who)
        return True

    def add_pilot(self, who: K) -> K | None:
        """A pilot always gets a place. If there are too many, the oldest loses its place."""
        self._new.pop(who, None)
        self._pilots[who] = None
        if len(self._pilots) <= MAX_PILOTS:
            return None
        oldest = next(iter(self._pilots))
        del self._pilots[oldest]
        return oldest

    def closed(self, who: K) -> None:
        self._new.pop(who, None)
        self._viewers.discard(who)
        self._pilots.pop(who, None)
