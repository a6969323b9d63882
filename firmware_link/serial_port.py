"""A serial port that comes back by itself."""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import Callable
from typing import Any

from serial_asyncio_fast import SerialTransport, create_serial_connection

RETRY_S = 0.3
_CLOSING_S = 1.0
MAX_QUEUED_BYTES = 16 * 1024
"""Over a second of a port at 115200 baud: what is older than that is not worth sending any more."""


class SerialPort:
    """Opens `path`, hands over what arrives, and opens it again whenever it is lost, until cancelled.

    `on_bytes` is called from the event loop with what arrived. `on_state(up, why)` is called when the port
    goes up or down, and when the reason why it is down changes; `why` is a sentence for people. Opened
    exclusively where the operating system allows it. Logs nothing.
    """

    def __init__(
        self,
        path: str,
        baud: int,
        on_bytes: Callable[[bytes], None],
        on_state: Callable[[bool, str], None],
    ) -> None:
        self.path = path
        self.baud = baud
        self.dropped_bytes = 0
        """Written while the port was down, or while too much was queued already."""
        self._on_bytes = on_bytes
        self._on_state = on_state
        self._reported: tuple[bool, str] | None = None
        self._connection: _Connection | None = None

    @property
    def connected(self) -> bool:
        return self._connection is not None

    def write(self, data: bytes) -> bool:
        """Send `data` as soon as the port takes it, never blocking; False when it is dropped."""
        if self._connection is None or not self._connection.write(data):
            self.dropped_bytes += len(data)
            return False
        return True

    async def run(self) -> None:
        """Keep the port open until cancelled; it is closed when this returns."""
        while True:
            try:
                connection = await self._open()
            except (OSError, ValueError) as error:
                self._report(False, _why_not(self.path, error))
            else:
                await self._serve(connection)
            await asyncio.sleep(RETRY_S)

    async def _open(self) -> _Connection:
        opening = asyncio.ensure_future(
            create_serial_connection(
                asyncio.get_running_loop(),
                lambda: _Connection(self._on_bytes, self._came_up),
                self.path,
                baudrate=self.baud,
                exclusive=True if os.name == "posix" else None,
            )
        )
        try:
            _, connection = await asyncio.shield(opening)
        except asyncio.CancelledError:
            # The thread that opens the port cannot be stopped; what it opens must not stay open.
            opening.add_done_callback(_close_again)
            raise
        assert isinstance(connection, _Connection)
        return connection

    async def _serve(self, connection: _Connection) -> None:
        try:
            why = await asyncio.shield(connection.lost)
            self._connection = None
            self._report(False, f"{self.path} was lost: {why}")
        finally:
            self._connection = None
            connection.close()
            # A driver may keep a port that was pulled out for long; nobody is to wait for it.
            await asyncio.wait([connection.gone], timeout=_CLOSING_S)

    def _came_up(self, connection: _Connection) -> None:
        self._connection = connection
        self._report(True, f"{self.path} is open")

    def _report(self, up: bool, why: str) -> None:
        if (up, why) != self._reported:
            self._reported = (up, why)
            self._on_state(up, why)


class _Connection(asyncio.Protocol):
    """One opening of the port."""

    def __init__(self, on_bytes: Callable[[bytes], None], on_up: Callable[[_Connection], None]) -> None:
        loop = asyncio.get_running_loop()
        self.lost: asyncio.Future[str] = loop.create_future()
        """Why, as soon as the connection is of no more use."""
        self.gone: asyncio.Future[None] = loop.create_future()
        """When the port is closed."""
        self._on_bytes = on_bytes
        self._on_up = on_up
        self._transport: SerialTransport | None = None
        self._queue: _WriteQueue | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, SerialTransport)
        self._transport = transport
        if self.lost.done():
            transport.abort()
            return
        if os.name == "posix" and transport.serial is not None:
            self._queue = _WriteQueue(transport.serial.fileno(), self._write_failed)
        self._on_up(self)

    def data_received(self, data: bytes) -> None:
        self._on_bytes(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._queue is not None:
            self._queue.close()
        self._lose(_why_lost(exc))
        if not self.gone.done():
            self.gone.set_result(None)

    def write(self, data: bytes) -> bool:
        if self._transport is None or self._transport.is_closing():
            return False
        if self._queue is not None:
            return self._queue.write(data)
        if self._transport.get_write_buffer_size() + len(data) > MAX_QUEUED_BYTES:
            return False
        self._transport.write(data)
        return True

    def close(self) -> None:
        """Close now, whatever is still to be sent."""
        self._lose("it was closed")
        if self._queue is not None:
            self._queue.close()
        if self._transport is not None and not self._transport.is_closing():
            self._transport.abort()

    def _write_failed(self, error: OSError) -> None:
        self._lose(_why_lost(error))

    def _lose(self, why: str) -> None:
        if not self.lost.done():
            self.lost.set_result(why)


class _WriteQueue:
    """Writes to a port without ever blocking.

    The transport's own writing ends in pyserial, which on a full port spins until there is room: a device
    that stops reading would stop this whole process.
    """

    def __init__(self, port_fd: int, on_error: Callable[[OSError], None]) -> None:
        # A descriptor of our own: the transport closes its one before it says so.
        self._fd = os.dup(port_fd)
        self._on_error = on_error
        self._loop = asyncio.get_running_loop()
        self._queued = bytearray()
        self._waiting = False
        self._closed = False

    def write(self, data: bytes) -> bool:
        if self._closed or len(self._queued) + len(data) > MAX_QUEUED_BYTES:
            return False
        self._queued += data
        if not self._waiting:
            self._flush()
        return True

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._wait(False)
        os.close(self._fd)

    def _flush(self) -> None:
        try:
            del self._queued[: os.write(self._fd, self._queued)]
        except (BlockingIOError, InterruptedError):
            pass
        except OSError as error:
            self.close()
            self._on_error(error)
            return
        self._wait(bool(self._queued))

    def _wait(self, wanted: bool) -> None:
        if wanted and not self._waiting:
            self._loop.add_writer(self._fd, self._flush)
        elif self._waiting and not wanted:
            self._loop.remove_writer(self._fd)
        self._waiting = wanted


def _close_again(opening: asyncio.Future[tuple[Any, Any]]) -> None:
    if not opening.cancelled() and opening.exception() is None:
        opening.result()[0].abort()


def _why_not(path: str, error: OSError | ValueError) -> str:
    """Why `path` could not be opened, and what to do about it."""
    code = getattr(error, "errno", None)
    if code in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return f"{path} is not there: is the board plugged in and powered, and is this the right port?"
    if code in (errno.EACCES, errno.EPERM):
        return (
            f"{path} may not be opened by this user: add yourself to the dialout group"
            " (sudo usermod -aG dialout $USER), then log in again"
        )
    if code in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK):
        return (
            f"{path} is in use by another program (a serial monitor, ModemManager, or a second copy of this)"
        )
    return f"{path} could not be opened: {getattr(error, 'strerror', None) or error}"


def _why_lost(error: Exception | None) -> str:
    if error is None:
        return "it was closed"
    return f"the board was unplugged or switched off, or another program reads the same port ({error})"
