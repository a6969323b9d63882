"""The gateway's process is always restarted, and the service never waits for it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from gateway_process import gateway_of
from ports import free_port
from real_time import real_time
from waiting import MAX_WAIT_S, until

from flying_vines.config.config import PageConfig
from flying_vines.core.events import Decision
from flying_vines.gateway import __main__ as gateway_process
from flying_vines.gateway import gateway, mqtt, page, supervisor
from flying_vines.gateway.feed import Feed
from flying_vines.gateway.gateway import Gateway
from flying_vines.gateway.messages import Alive, GatewayStart, Trouble, packet, read_from_gateway
from flying_vines.vine.intent import Asker, Hold, Intent, StartBench, VentVine

from .gateway_inputs import configured, decision, notice, snapshot
from .mqtt.brokers import Broker, Onlooker

pytestmark = real_time

BASE = "flying-vines/heron"
CHILD = """\
import os, socket, sys, time
import msgspec
from flying_vines.gateway.messages import Alive, Request, Trouble, packet, read_to_gateway
service = socket.socket(fileno=int(sys.argv[1]))
def say(message): service.send(packet(message))
def receive(): return read_to_gateway(service.recv(1 << 20))
start = receive()
"""


class Service:
    """The part of a service that a gateway needs; `run` is a real process, or a script in its place."""

    def __init__(self, **mqtt: Any) -> None:
        self.reports: list[str] = []
        self.asked: list[tuple[Asker, Intent]] = []
        self.times: list[tuple[float | None, float | None]] = []
        """For each request: its time, and the time of the state that its sender saw."""
        self.gateway = Gateway(configured(**mqtt), self._ask, self.reports.append)
        self.latest_turn_s = 0.0

    def _ask(self, by: Asker, intent: Intent, made_at: float | None, seen_at: float | None) -> Decision:
        self.asked.append((by, intent))
        self.times.append((made_at, seen_at))
        return Decision(0.0, by, {}, str(intent), "limited", "as a test", 0.0)

    @contextlib.asynccontextmanager
    async def living(self) -> AsyncIterator[Service]:
        parts = [asyncio.create_task(part) for part in (self.gateway.run(), self._fly())]
        try:
            yield self
        finally:
            for part in parts:
                part.cancel()
            await asyncio.gather(*parts, return_exceptions=True)

    async def _fly(self) -> None:
        """The loop that must not be delayed; records its longest turn."""
        while True:
            began = time.perf_counter()
            self.gateway.snapshot(snapshot(asyncio.get_running_loop().time()))
            self.latest_turn_s = max(self.latest_turn_s, time.perf_counter() - began)
            await asyncio.sleep(0.1)


@pytest.fixture(autouse=True)
def in_a_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor, "FIRST_WAIT_S", 0.1)
    monkeypatch.setattr(gateway, "POLL_S", 0.1)
    # Scripts in place of a gateway only print what the test needs.
    monkeypatch.setattr(gateway, "HANGS_S", 60.0)


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Replace the gateway by a script that has read the start. After the script it hangs."""

    def play(script: str) -> None:
        monkeypatch.setattr(
            gateway, "COMMAND", (*gateway.COMMAND[:1], "-c", f"{CHILD}{script}\ntime.sleep(3600)")
        )

    return play


async def test_a_gateway_that_is_killed_leaves_its_last_will_and_comes_back(
    broker: Broker, people: Onlooker
) -> None:
    async with Service(broker=broker.url, name="heron", commands=("vent",)).living() as service:
        await people.until(f"{BASE}/status", status="online")
        await people.until(f"{BASE}/state", doing="bend-full")
        service.gateway.action(decision(1.0))
        await people.until(f"{BASE}/event", event="decision", number=1)
        await people.say(f"{BASE}/ask", {"id": "1", "unix_s": time.time(), "command": "vent"})
        await people.until(f"{BASE}/answer", id="1", safety="limited", reason="as a test")
        assert service.asked == [("broker", VentVine())]

        os.kill(gateway_of(os.getpid()), signal.SIGKILL)
        await people.until(f"{BASE}/status", status="offline")
        service.gateway.action(notice(2.0, "while it was away"))
        await people.until(f"{BASE}/status", status="online", count=2)
        await people.until(f"{BASE}/event", text="while it was away")
        assert service.reports == ["page and broker stopped (it ended), starting again"]
        assert service.latest_turn_s < 0.5
    # The service ends, and its gateway with it. The subscribers are told.
    await people.until(f"{BASE}/status", status="offline", count=2)


async def test_a_gateway_reports_that_its_service_was_killed(broker: Broker, people: Onlooker) -> None:
    """It ends by itself, without an error."""
    service = Service(broker=broker.url, name="heron")
    async with service.living():
        await people.until(f"{BASE}/status", status="online")
        pid = gateway_of(os.getpid())
        its_socket = service.gateway._socket
        assert its_socket is not None
        its_socket.shutdown(2)
        await people.until(f"{BASE}/status", status="offline")
        await until(lambda: not Path(f"/proc/{pid}").exists(), "it has ended")


async def test_a_gateway_that_hangs_is_replaced_and_delays_nothing(
    monkeypatch: pytest.MonkeyPatch, played: Callable[[str], None]
) -> None:
    monkeypatch.setattr(gateway, "HANGS_S", 0.5)
    played("say(Trouble(str(os.getpid())))")
    async with Service().living() as service:
        await until(lambda: len(service.reports) == 1, "it has started")
        first = int(service.reports[0])
        # The socket's buffer is soon full.
        for number in range(2000):
            service.gateway.action(notice(0.0, f"{number}"))
            service.gateway.snapshot(snapshot(0.0))
        await until(lambda: len(service.reports) == 3, "it is replaced")
        assert service.reports[1] == "page and broker stopped (it hung), starting again"
        await until(lambda: not Path(f"/proc/{first}").exists(), "it is ended")
        assert service.latest_turn_s < 0.5


async def test_a_gateway_is_not_to_blame_where_the_service_stopped(
    monkeypatch: pytest.MonkeyPatch, played: Callable[[str], None]
) -> None:
    monkeypatch.setattr(gateway, "HANGS_S", 0.5)
    played("while True:\n    say(Alive())\n    time.sleep(0.05)")
    async with Service().living() as service:
        await until(lambda: service.gateway._alive, "it has started")
        pid = gateway_of(os.getpid())
        for _ in range(2):
            time.sleep(0.7)  # noqa: ASYNC251
            await asyncio.sleep(0.2)
        assert gateway_of(os.getpid()) == pid
    assert not service.reports


async def test_a_gateway_has_time_to_start(
    monkeypatch: pytest.MonkeyPatch, played: Callable[[str], None]
) -> None:
    monkeypatch.setattr(gateway, "HANGS_S", 0.2)
    monkeypatch.setattr(gateway, "STARTS_S", 1.0)
    played("")
    async with Service().living() as service:
        began = time.monotonic()
        await until(lambda: bool(service.reports), "it is ended")
    assert "it hung" in service.reports[0]
    assert time.monotonic() - began >= 1.0


async def test_a_gateway_that_ends_at_once_is_reported_once(
    played: Callable[[str], None], tmp_path: Path
) -> None:
    tries = tmp_path / "tries"
    tries.touch()
    played(f"open({str(tries)!r}, 'a').write('.')\nsys.exit('first line\\nthe reason')\n")
    async with Service().living() as service:
        await until(lambda: len(tries.read_text()) == 3, "three tries")
    assert service.reports == ["page and broker stopped (the reason), starting again"]


async def test_a_page_that_fails_is_served_again_and_the_broker_does_not_notice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Both are in the gateway's process."""
    page_serve, starts, served, told = page.serve, [0], asyncio.Event(), []

    async def fails_twice(feed: Feed) -> None:
        starts[0] += 1
        if starts[0] <= 2:
            raise ZeroDivisionError("a mistake of ours")
        served.set()
        await page_serve(feed)

    async def broker(feed: Feed) -> None:
        told.append("the broker is looked for")
        await asyncio.sleep(3600.0)

    monkeypatch.setattr(page, "serve", fails_twice)
    monkeypatch.setattr(mqtt, "serve", broker)
    config = configured(broker="mqtt://127.0.0.1:1", name="heron")
    config = msgspec.structs.replace(config, page=PageConfig(port=free_port()))
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    loop = asyncio.get_running_loop()
    with ours, theirs:
        ours.setblocking(False)
        theirs.setblocking(False)
        serving = asyncio.create_task(gateway_process.serve(theirs))
        ours.send(packet(GatewayStart(config, "1.2.3")))
        async with asyncio.timeout(MAX_WAIT_S):
            await served.wait()
            alive = 0
            while alive < 2:
                said = read_from_gateway(await loop.sock_recv(ours, 65536))
                if isinstance(said, Alive):
                    alive += 1
                else:
                    told.append(said.text if isinstance(said, Trouble) else str(said))
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)
    assert told == [
        "the broker is looked for",
        "page stopped (ZeroDivisionError: a mistake of ours), starting again",
    ]


async def test_a_gateway_that_sends_invalid_messages_is_ended(played: Callable[[str], None]) -> None:
    played('service.send(b\'{"kind": "order"}\')')
    async with Service().living() as service:
        await until(lambda: len(service.reports) == 1, "it is ended")
    assert "it sent an invalid message: Invalid value 'order'" in service.reports[0]
    assert not service.asked


async def test_a_gateway_that_cannot_be_started_is_tried_again(
    monkeypatch: pytest.MonkeyPatch, played: Callable[[str], None]
) -> None:
    command = gateway.COMMAND
    monkeypatch.setattr(gateway, "COMMAND", ("/no/such/python",))
    async with Service().living() as service:
        await until(lambda: len(service.reports) == 1, "it is told")
        monkeypatch.setattr(gateway, "COMMAND", command)
        played("say(Trouble('started'))")
        await until(lambda: len(service.reports) == 2, "it is tried again")
    assert service.reports == [
        "page and broker stopped (No such file or directory), starting again",
        "started",
    ]


async def test_a_client_that_asks_too_often_may_still_vent(played: Callable[[str], None]) -> None:
    played(
        "for number in range(100): say(Request(number, 'page', 'start_bench'))\n"
        "say(Request(100, 'page', 'vent'))\n"
        "answers = {}\n"
        "while 100 not in answers:\n"
        "    told = receive()\n"
        "    if hasattr(told, 'safety'): answers[told.number] = told.safety + told.reason\n"
        "say(Trouble(f\"{list(answers.values()).count('refusedtoo many requests')} {answers[100]}\"))\n"
    )
    async with Service().living() as service:
        await until(lambda: len(service.reports) == 1, "it has asked")
    refused, vented = service.reports[0].split(" ", 1)
    assert vented == "limitedas a test"
    asked = [intent for _, intent in service.asked]
    assert asked[-1] == VentVine()
    assert asked.count(StartBench()) == 100 - int(refused)
    assert 20 <= asked.count(StartBench()) <= 25


async def test_a_flood_of_vents_is_a_few_vents_and_each_is_answered(played: Callable[[str], None]) -> None:
    played(
        "for number in range(200): say(Request(number, 'page', 'vent'))\n"
        "say(Request(200, 'page', 'hold'))\n"
        "answers = {}\n"
        "while len(answers) < 201:\n"
        "    told = receive()\n"
        "    if hasattr(told, 'safety'): answers[told.number] = told.safety\n"
        "say(Trouble(f'{set(answers.values())}'))\n"
    )
    async with Service().living() as service:
        await until(lambda: len(service.reports) == 1, "all is answered")
    assert service.reports == ["{'limited'}"]
    asked = [intent for _, intent in service.asked]
    assert 2 <= asked.count(VentVine()) < 20
    # No request after a vent is executed before it.
    assert asked[-1] == Hold()


async def test_a_vent_that_waits_comes_by_itself(played: Callable[[str], None]) -> None:
    """The bend between two vents must not remain if the second vent came too soon."""
    played("for number in range(3): say(Request(number, ('page', 'broker')[number % 2], 'vent'))\n")
    async with Service().living() as service:
        await until(lambda: len(service.asked) == 3, "the last vents")
    assert service.asked == [("page", VentVine()), ("broker", VentVine()), ("page", VentVine())]


async def test_when_it_was_made_and_what_was_seen_goes_on_to_the_service(
    played: Callable[[str], None],
) -> None:
    """A combined vent clears the faults that any of its senders has seen."""
    played(
        "say(Request(1, 'page', 'hold', made_at=3.25, seen_at=3.0))\n"
        "say(Request(2, 'page', 'vent', seen_at=1.0))\n"
        "for number, seen in enumerate((None, 4.0, 2.0)):\n"
        "    say(Request(number, 'page', 'vent', seen_at=seen))\n"
    )
    async with Service().living() as service:
        await until(lambda: len(service.asked) == 3, "all are asked")
    assert service.times == [(3.25, 3.0), (None, 1.0), (None, 4.0)]


async def test_events_before_the_gateway_reads_are_sent_in_order(
    played: Callable[[str], None],
) -> None:
    """The start comes first. Of too many events the last ones are stored."""
    played(
        "texts = []\n"
        "while not texts or texts[-1] != 599:\n"
        "    told = receive()\n"
        "    if hasattr(told, 'fields'): texts.append(int(msgspec.json.decode(told.fields)['text']))\n"
        "say(Trouble(f'{type(start).__name__} {texts == list(range(100, 600))}'))\n"
    )
    service = Service()
    for number in range(600):
        service.gateway.action(notice(0.0, str(number)))
    async with service.living():
        await until(lambda: len(service.reports) == 1, "it has received them")
    assert service.reports == ["GatewayStart True"]
