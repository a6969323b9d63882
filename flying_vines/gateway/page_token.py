"""The word that opens the page from the network, and the file that it is kept in.

From it follows a second one for those who may only watch.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import os
import re
import secrets
import socket
import stat
from ipaddress import ip_address
from pathlib import Path

from flying_vines.config.config import Page

RANDOM_BYTES = 10
"""As long as no guessing over a network comes through, as short as a thumb can type."""
SHORTEST, LONGEST = 12, 128
_GROUP = 4
_FORM = re.compile(rf"[a-z2-7]{{{SHORTEST},{LONGEST}}}")


class PageTokenError(Exception):
    """The token's file cannot be used; the text is one line that says which, why and what to do."""


def read_or_make(path: Path) -> str:
    """The token in a file that nobody else may read; a new one where there is no file.

    Raises `PageTokenError`.
    """
    if path.exists():
        return read(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise PageTokenError(f"{path}: the page's token cannot be written: {error.strerror}") from None
    token = _written(secrets.token_bytes(RANDOM_BYTES))
    with os.fdopen(number, "w", encoding="ascii") as file:
        file.write(f"{token}\n{watching(token)} only watches\n")
    return token


def read(path: Path) -> str:
    """Raises `PageTokenError`."""
    try:
        if path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
            raise PageTokenError(f"{path}: others may read or change the page's token: chmod 600 {path}")
        token, *_ = path.read_text(encoding="utf-8", errors="replace").splitlines() or [""]
    except OSError as error:
        raise PageTokenError(f"{path}: the page's token cannot be read: {error.strerror}") from None
    if not _FORM.fullmatch(_plain(token)):
        raise PageTokenError(
            f"{path}: no token for the page in it: take the file away, and the service makes a new one"
        )
    return token.strip()


def address(page: Page, token: str = "") -> str:
    """What to type into a browser, here or on the network."""
    host = page.host
    if ip_address(host).is_unspecified:
        host = f"{socket.gethostname()}.local"
    elif ":" in host:
        host = f"[{host}]"
    return f"http://{host}:{page.port}/" + (f"?token={token}" if token else "")


def watching(token: str) -> str:
    """The token of those who may only watch: it tells nothing of the one that it follows from."""
    key = _plain(token).encode()
    return _written(hmac.digest(key, b"flying-vines: who may watch", hashlib.sha256)[:RANDOM_BYTES])


def same(given: str, token: str) -> bool:
    """Compared in a time that does not tell how much of it is right; as people type it."""
    return hmac.compare_digest(_plain(given).encode(), _plain(token).encode())


def _plain(text: str) -> str:
    return text.strip().lower().replace("-", "").replace(" ", "")


def _written(data: bytes) -> str:
    letters = base64.b32encode(data).decode("ascii").lower()
    return "-".join(letters[i : i + _GROUP] for i in range(0, len(letters), _GROUP))
