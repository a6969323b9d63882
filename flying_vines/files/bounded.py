"""Reads files whose content nobody has checked: only regular files, and only up to a size.

A FIFO would wait for ever, a device such as /dev/zero has no end, and a file may grow while it is read. So
the size is counted in the bytes that arrive.
"""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

MB = 1_000_000
TEXT_BYTES = MB
"""A file that a person writes: a configuration, a rig, a mission."""
TABLE_BYTES = 32 * MB
"""A recording as text: an hour at 100 Hz has 15 MB. Its cells take ten times as much memory."""
RECORDING_BYTES = 256 * MB
"""A recorded stream: a ground station's link at 57,600 baud takes ten hours for it."""


_UTF_16 = re.compile(rb"\xff\xfe[\t-~]\0|\xfe\xff\0[\t-~]")
"""Some editors of Windows write this: a byte order mark and an ASCII character."""


def opened(path: Path) -> BinaryIO:
    """The file, open for reading. Raises `OSError`, with one line in `strerror`, if it is no regular file."""
    # Without O_NONBLOCK, a FIFO blocks here until somebody writes to it.
    number = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    mode = os.fstat(number).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(number, "rb")
    os.close(number)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise OSError(errno.EINVAL, "it is a pipe or a device, not a file", str(path))


def decoded(data: bytes) -> str:
    """The text that a person wrote with any editor: without byte order mark, and with plain line ends.

    Raises `UnicodeDecodeError`.
    """
    encoding = "utf-16" if _UTF_16.match(data) else "utf-8-sig"
    return data.decode(encoding).replace("\r\n", "\n").replace("\r", "\n")


def first_line(text: str) -> str:
    """The first line of a file that holds one text; without comments, which begin with "#", and spaces."""
    lines = (line.strip() for line in text.splitlines())
    return next((line for line in lines if line and not line.startswith("#")), "")


def read_bytes(path: Path, most_bytes: int = TEXT_BYTES) -> bytes:
    """The content of a regular file. Raises `OSError`, with one line in `strerror`, also if it is larger."""
    with opened(path) as file:
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"it has more than {most_bytes / MB:g} MB", str(path))
    return data


def read_private(path: Path, what: str, error: Callable[[str], Exception], remedy: str = "") -> bytes:
    """The content of a file that only its owner may read or change; raises `error` with one line."""
    try:
        mode = path.stat().st_mode
        if stat.S_ISREG(mode) and mode & 0o077:
            raise error(f"{path}: others may read or change {what}: chmod 600 {path}")
        return read_bytes(path)
    except OSError as problem:
        raise error(f"{path}: {what} cannot be read: {problem.strerror}{remedy}") from None
