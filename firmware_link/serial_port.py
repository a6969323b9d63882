"""A serial port that is opened again after every loss and every long silence."""

from __future__ import annotations

import asyncio
import errno
import os
import select
from collections import deque
from collections.abc import Callable
from typing import Any

from serial_asyncio_fast import SerialTransport, create_serial_connection

from firmware_link.find import BoardNotFoundError, Ports, UsbBoard
from firmware_link.reconnect import KeptOpen, Policy, Problem

POLICY = Policy(first_wait_s=0.2, longest_wait_s=0.5, quiet_s=5.0)
"""A try takes about 1 ms of processor time. A board that is plugged in again must be connected within 1 s.

The name of a silent port may lead to another port by now. A silent board has vented long before, by its
dead-man or by our command. Opening sets DTR. A Teensy does not reset by that, only by a speed of 134 baud."""
_CLOSING_S = 0.5
STALE_S = 0.25
"""Data that waits longer is dropped, because a setpoint is valid only for this time."""
MAX_QUEUED_BYTES = 16 * 1024
"""More than this program sends within `STALE_S`."""


class SerialPort:
    """Opens a port, passes on the received bytes, and reopens it after every loss, until cancelled.

    `where` is a device's path, or a board, which is searched each time among `ports` (default: this
    machine's). `on_bytes` is called from the event loop with received bytes. `on_state(up, why)` is called
    when the port goes up or down, and when the reason for being down changes. `why` is a sentence for people.
    The port is opened exclusively if the operating system supports it.
    """

    def __init__(
        self,
        where: str | UsbBoard,
        baud: int,
        on_bytes: Callable[[bytes], None],
        on_state: Callable[[bool, str], None],
        ports: Ports | None = None,
    ) -> None:
        self.where = where
        self.baud = baud
        self._dropped_bytes = 0
        self._ports = ports
        self._on_bytes = on_bytes
        self._kept = KeptOpen(POLICY, self._connect, on_state)
        self._connection: _Connection | None = None
        self._closing: asyncio.Future[None] | None = None

    @property
    def connected(self) -> bool:
        return self._connection is not None

    @property
    def dropped_bytes(self) -> int:
        """Bytes that were not sent, because the port was down or too slow."""
        return self._dropped_bytes + (self._connection.dropped_bytes if self._connection else 0)

    def write(self, data: bytes) -> bool:
        """Send `data`, a complete message, as soon as the port accepts it. Never blocks. False: dropped.

        Messages that wait longer than `STALE_S` are dropped. So a device that reads again after a pause gets
        only current messages.
        """
        if self._connection is None or not self._connection.write(data):
            self._dropped_bytes += len(data)
            return False
        return True

    async def run(self) -> None:
        """Keep the port open until cancelled; then close it."""
        try:
            await self._kept.run()
        finally:
            await self._closed()

    async def _closed(self) -> None:
        """Wait until the last connection is closed, but not long: a driver may keep an unplugged port."""
        if self._closing is not None:
            await asyncio.wait([self._closing], timeout=_CLOSING_S)

    async def _connect(self) -> Problem:
        await self._closed()
        name = str(self.where)
        try:
            path = await self._find()
            name = path if path == name else f"{name} ({path})"
            connection = await self._open(path, name)
        except BoardNotFoundError as error:
            return Problem(str(error))
        except (OSError, ValueError) as error:
            return Problem(_why_not(name, error))
        return Problem(f"{name} was lost: {await self._serve(connection)}")

    async def _find(self) -> str:
        if isinstance(self.where, str):
            return self.where
        # The list of ports is read from files, which may be slow.
        return await asyncio.to_thread(self.where.find, self._ports)

    async def _open(self, path: str, name: str) -> _Connection:
        opening = asyncio.ensure_future(
            create_serial_connection(
                asyncio.get_running_loop(),
                lambda: _Connection(self._received, lambda connection: self._came_up(connection, name)),
                path,
                baudrate=self.baud,
                exclusive=True if os.name == "posix" else None,
            )
        )
        try:
            _, connection = await asyncio.shield(opening)
        except asyncio.CancelledError:
            # The thread that opens the port cannot be stopped. Close the port once it is open.
            opening.add_done_callback(_close_again)
            raise
        assert isinstance(connection, _Connection)
        return connection

    async def _serve(self, connection: _Connection) -> str:
        try:
            return await asyncio.shield(connection.lost)
        finally:
            connection.close()
            self._dropped_bytes = self.dropped_bytes
            self._connection, self._closing = None, connection.gone

    def _came_up(self, connection: _Connection, name: str) -> None:
        self._connection = connection
        self._kept.opened(f"{name} is open")

    def _received(self, data: bytes) -> None:
        self._kept.heard()
        self._on_bytes(data)


class _Connection(asyncio.Protocol):
    """One connection, from the opening of the port to its loss."""

    def __init__(self, on_bytes: Callable[[bytes], None], on_up: Callable[[_Connection], None]) -> None:
        loop = asyncio.get_running_loop()
        self.lost: asyncio.Future[str] = loop.create_future()
        """The reason, as soon as the connection is lost."""
        self.gone: asyncio.Future[None] = loop.create_future()
        """Done when the port is closed."""
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

    @property
    def dropped_bytes(self) -> int:
        return self._queue.dropped_bytes if self._queue else 0

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
        """Close now, without sending queued data."""
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
    """Writes to a port without blocking, and drops data that is out of date.

    The transport writes by pyserial, which blocks on a full port until there is room. So a device that stops
    reading would stop this whole process. The kernel would also accept kilobytes, which we could not drop
    later. It reports a serial port as writable only while less than 256 bytes wait in it. So we poll the port
    before each write and keep the rest in this queue.
    """

    def __init__(self, port_fd: int, on_error: Callable[[OSError], None]) -> None:
        self.dropped_bytes = 0
        # A copy, because the transport closes its own descriptor before it calls `connection_lost`.
        self._fd = os.dup(port_fd)
        self._on_error = on_error
        self._loop = asyncio.get_running_loop()
        self._writable = select.poll()
        self._writable.register(self._fd, select.POLLOUT)
        self._begun = b""
        """The rest of a partly sent message."""
        self._queued: deque[tuple[float, bytes]] = deque()
        """(time of the write, message)."""
        self._queued_bytes = 0
        self._waiting = False
        self._closed = False

    def write(self, data: bytes) -> bool:
        if self._closed or len(data) > MAX_QUEUED_BYTES:
            return False
        self._queued.append((self._loop.time(), data))
        self._queued_bytes += len(data)
        self._drop_old()
        if not self._waiting:
            self._flush()
        return True

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self.dropped_bytes += len(self._begun) + self._queued_bytes
        self._wait(False)
        os.close(self._fd)

    def _drop_old(self) -> None:
        oldest = self._loop.time() - STALE_S
        while self._queued and (self._queued[0][0] < oldest or self._queued_bytes > MAX_QUEUED_BYTES):
            self.dropped_bytes += len(self._next())

    def _next(self) -> bytes:
        _, data = self._queued.popleft()
        self._queued_bytes -= len(data)
        return data

    def _flush(self) -> None:
        self._drop_old()
        try:
            while (self._begun or self._queued) and self._writable.poll(0):
                data = self._begun or self._next()
                self._begun = data
                self._begun = data[os.write(self._fd, data) :]
        except (BlockingIOError, InterruptedError):
            pass
        except OSError as error:
            self.close()
            self._on_error(error)
            return
        self._wait(bool(self._begun or self._queued))

    def _wait(self, wanted: bool) -> None:
        if wanted and not self._waiting:
            self._loop.add_writer(self._fd, self._flush)
        elif self._waiting and not wanted:
            self._loop.remove_writer(self._fd)
        self._waiting = wanted


def _close_again(opening: asyncio.Future[tuple[Any, Any]]) -> None:
    if not opening.cancelled() and opening.exception() is None:
        opening.result()[0].abort()


def _why_not(name: str, error: OSError | ValueError) -> str:
    """Why the port could not be opened, and what to do about it."""
    code = getattr(error, "errno", None)
    if code in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return f"{name} is not there: is the board plugged in and powered, and is this the right port?"
    if code in (errno.EACCES, errno.EPERM):
        return (
            f"{name} may not be opened by this user: add yourself to the dialout group"
            " (sudo usermod -aG dialout $USER), then log in again"
        )
    if code in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK):
        return (
            f"{name} is in use by another program (a serial monitor, ModemManager, or a second copy of this"
            " program)"
        )
    return f"{name} could not be opened: {getattr(error, 'strerror', None) or error}"


def _why_lost(error: Exception | None) -> str:
    if error is None:
        return "it was closed"
    return f"the board was unplugged or switched off, or another program reads the same port ({error})"
