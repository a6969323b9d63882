"""The token that opens the page from the network, its file, and the watch-only token."""

from __future__ import annotations

import base64
import hashlib
import hmac
import os
import re
import secrets
import socket
from ipaddress import ip_address
from pathlib import Path

from flying_vines.config.config import PageConfig
from flying_vines.files.bounded import decoded, first_line, read_private

RANDOM_BYTES = 10
"""Too long to guess over a network, short enough to type on a phone."""
MIN_LENGTH, MAX_LENGTH = 12, 128
_GROUP = 4
_FORM = re.compile(rf"[a-z2-7]{{{MIN_LENGTH},{MAX_LENGTH}}}")


class PageTokenError(Exception):
    """The token's file cannot be used. The text is one line: the file, why, and what to do."""


def read_or_make(path: Path) -> str:
    """The token in a private file; a new one if there is no file. Raises `PageTokenError`."""
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
        token = first_line(decoded(read_private(path, "the page's token", PageTokenError)))
    except UnicodeDecodeError:
        token = ""
    if not _FORM.fullmatch(_plain(token)):
        raise PageTokenError(
            f"{path}: contains no valid page token: delete the file; the service then creates a new one"
        )
    return token


def address(page: PageConfig, token: str = "") -> str:
    """The URL for a browser, on this computer or in the network."""
    host = page.host
    if ip_address(host).is_unspecified:
        host = f"{socket.gethostname()}.local"
    elif ":" in host:
        host = f"[{host}]"
    return f"http://{host}:{page.port}/" + (f"?token={token}" if token else "")


def watching(token: str) -> str:
    """The token for watching only. The full token cannot be derived from it."""
    key = _plain(token).encode()
    return _written(hmac.digest(key, b"flying-vines: who may watch", hashlib.sha256)[:RANDOM_BYTES])


def same(given: str, token: str) -> bool:
    """Compares in constant time, ignoring case, spaces and hyphens."""
    return hmac.compare_digest(_plain(given).encode(), _plain(token).encode())


def _plain(text: str) -> str:
    return text.strip().lower().replace("-", "").replace(" ", "")


def _written(data: bytes) -> str:
    letters = base64.b32encode(data).decode("ascii").lower()
    return "-".join(letters[i : i + _GROUP] for i in range(0, len(letters), _GROUP))
