"""Attackers of the page and the broker: every attack, as fast as possible.

One process, with a thread and an address of this machine for each attacker. No attack may succeed. An
attacker counts what it sent, and how often it got what it wanted.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import random
import resource
import socket
import struct
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from mqtt_fleet import connect_packet, publish_packet

HELD = 1000
"""Connections that one attacker keeps open, each with half a request."""
SLOW_READERS = 16
FIRST_ADDRESS = 10
MAX_WAIT_S = 0.5
BATCH = 50
"""Messages to the broker in one write."""
Attack = Callable[[str], None]
"""A function that attacks from the given address of this machine, until its connection fails."""


@dataclass(frozen=True)
class Target:
    """The page's port, a token that may only watch, and the broker's port and topic."""

    page_port: int
    token: str
    broker_port: int
    topic: str
    allowed: str
    """The only command that the configuration allows."""


@dataclass
class Harm:
    """Numbers of requests and messages that the attackers sent, by kind."""

    done: Counter[str] = field(default_factory=Counter)
    let_in: Counter[str] = field(default_factory=Counter)
    """Requests that succeeded although they must be refused."""
    seconds: float = 0.0
    cpu_s: float = 0.0


class Strangers:
    """The running attackers."""

    def __init__(self, lead: Connection, pid: int) -> None:
        self.pid = pid
        self._lead = lead

    def count(self) -> None:
        """Start counting."""
        self._lead.send("count")

    def tell(self) -> Harm:
        """The counts since `count`."""
        self._lead.send("tell")
        harm: Harm = self._lead.recv()
        return harm


@contextlib.contextmanager
def attacking(target: Target, niceness: int, core: int | None = None) -> Iterator[Strangers]:
    """Attack from a process with this niceness, only on this core if one is given."""
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.Process(target=_attack_all, args=(target, niceness, core, theirs), daemon=True)
    process.start()
    try:
        yield Strangers(ours, process.pid or 0)
    finally:
        process.kill()
        process.join()


def _attack_all(target: Target, niceness: int, core: int | None, lead: Connection) -> None:
    os.nice(niceness)
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    if core is not None:
        os.sched_setaffinity(0, {core})
    harm = Harm()
    for number, attack in enumerate(_attacks(target, harm)):
        address = f"127.0.0.{FIRST_ADDRESS + number}"
        threading.Thread(target=_again_and_again, args=(attack, address), daemon=True).start()
    while True:
        lead.recv()
        harm.done.clear()
        began, used_s = time.monotonic(), time.process_time()
        lead.recv()
        harm.seconds, harm.cpu_s = time.monotonic() - began, time.process_time() - used_s
        lead.send(harm)


def _again_and_again(attack: Attack, address: str) -> None:
    while True:
        # The page or the broker may close the socket at any time. Then the attack starts again.
        with contextlib.suppress(OSError):
            attack(address)


def _attacks(target: Target, harm: Harm) -> list[Attack]:
    page = f"127.0.0.1:{target.page_port}"
    watching = f"Authorization: Bearer {target.token}\r\n"

    def asks(kind: str, *lines: str, body: bytes = b"") -> Attack:
        request = "\r\n".join(lines).encode() + b"\r\n\r\n" + body

        def attack(address: str) -> None:
            with _connected(target.page_port, address) as page:
                harm.done[kind] += 1
                with contextlib.suppress(ConnectionError):
                    page.sendall(request)
                if page.recv(4096).startswith((b"HTTP/1.1 2", b"HTTP/1.1 101")):
                    harm.let_in[kind] += 1

        return attack

    def mqtt_attack(kind: str, message: Callable[[], bytes], retain: bool = False) -> Attack:
        def attack(address: str) -> None:
            with _connected(target.broker_port, address) as broker:
                broker.sendall(connect_packet(f"stranger-{random.getrandbits(32):x}"))
                while True:
                    batch = [publish_packet(target.topic, message(), retain) for _ in range(BATCH)]
                    broker.sendall(b"".join(batch))
                    harm.done[kind] += BATCH

        return attack

    def a_thousand(address: str) -> None:
        held: deque[socket.socket] = deque()
        while True:
            connection = _connected(target.page_port, address)
            connection.send(b"GET / HTTP/1.1\r\nX: ")
            harm.done["half a request"] += 1
            held.append(connection)
            if len(held) > HELD:
                held.popleft().close()

    def slow_readers(address: str) -> None:
        with contextlib.ExitStack() as stack:
            for _ in range(SLOW_READERS):
                viewer = socket.socket()
                stack.callback(viewer.close)
                viewer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
                viewer.settimeout(MAX_WAIT_S)
                viewer.bind((address, 0))
                viewer.connect(("127.0.0.1", target.page_port))
                viewer.sendall(_upgrade(page, target.token))
                harm.done["viewer that does not read"] += 1
            time.sleep(2.0)

    def sends(kind: str, frame: bytes) -> Attack:
        def attack(address: str) -> None:
            with _connected(target.page_port, address) as viewer:
                viewer.sendall(_upgrade(page, target.token))
                viewer.recv(4096)
                while True:
                    viewer.sendall(frame)
                    harm.done[kind] += 1

        return attack

    def fresh() -> bytes:
        ask = f'{{"id":"{random.getrandbits(60):x}","unix_s":{time.time():.3f},"command":"{target.allowed}"}}'
        return ask.encode()

    here = f"Host: {page}"
    return [
        asks("wrong token", "GET /?token=abcd-efgh-ijkl-mnop HTTP/1.1", here),
        asks("wrong token", "GET /live HTTP/1.1", here, "Authorization: Bearer " + "x" * 150),
        asks("no token", "GET /page.js HTTP/1.1", here, "Cookie: " + "flying-vines-1=a; " * 200),
        asks("another site's page", "GET /live HTTP/1.1", here, watching + "Origin: http://evil.example"),
        asks("another site's page", "GET / HTTP/1.1", "Host: evil.example", watching + "X: 1"),
        asks("request too large", "GET / HTTP/1.1", here, "X: " + "x" * 100_000),
        asks("request too large", "POST / HTTP/1.1", here, "Content-Length: 1000000", body=bytes(1_000_000)),
        asks("no request", os.urandom(2000).hex()),
        a_thousand,
        slow_readers,
        sends("command of a viewer", _frame(b'{"id":1,"command":"vent"}')),
        sends("command not understood", _frame(b"[" * 400)),
        sends("command too large", _frame(b"x" * 1_000_000)),
        mqtt_attack("message not understood", lambda: b'{"command": [[[[' + b"[" * 900),
        mqtt_attack("message too large", lambda: b"x" * 3000),
        mqtt_attack("retained message", fresh, retain=True),
        mqtt_attack("command not listed", lambda: fresh().replace(target.allowed.encode(), b"vent")),
        mqtt_attack("asked too often", fresh),
    ]


def _connected(port: int, address: str) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), MAX_WAIT_S, (address, 0))


def _upgrade(page: str, token: str) -> bytes:
    return (
        f"GET /live HTTP/1.1\r\nHost: {page}\r\nAuthorization: Bearer {token}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    ).encode()


def _frame(text: bytes) -> bytes:
    """A frame as a browser sends it, masked with zeros."""
    size = len(text)
    if size < 126:
        head = struct.pack(">BB", 0x81, 0x80 | size)
    elif size < 65536:
        head = struct.pack(">BBH", 0x81, 0x80 | 126, size)
    else:
        head = struct.pack(">BBQ", 0x81, 0x80 | 127, size)
    return head + bytes(4) + text
