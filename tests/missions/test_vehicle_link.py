"""The listener on mavsdk's threads, without mavsdk; and links in mavsdk's notation."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from missions.link import MAX_WAITING, MessageQueue, mavsdk_url

VEHICLE = 3


class Direct:
    """Replaces mavsdk's plugin: it calls the listener on a thread of its own."""

    def __init__(self) -> None:
        self.subscribed: dict[str, Callable[[Any, object], None]] = {}

    def subscribe_message(self, name: str, callback: Callable[[Any, object], None]) -> str:
        self.subscribed[name] = callback
        return name

    def unsubscribe_message(self, name: str) -> None:
        del self.subscribed[name]

    def say(self, name: str, *texts: str, system_id: int = VEHICLE) -> None:
        def speak() -> None:
            for text in texts:
                sender = {"system_id": system_id, "component_id": 191}
                message = SimpleNamespace(message_name=name, fields_json=text, **sender)
                self.subscribed[name](message, None)

        thread = threading.Thread(target=speak)
        thread.start()
        thread.join()


async def test_messages_of_a_thread_arrive_in_order() -> None:
    direct = Direct()
    queue = MessageQueue(direct, ["A", "B"], VEHICLE)
    direct.say("A", '{"n": 1}', '{"n": 2}', "{ no json")
    direct.say("B", '{"n": 3}')
    received = await queue.receive(1.0)
    assert [(each.name, each.component, each.fields["n"]) for each in received] == [
        ("A", 191, 1),
        ("A", 191, 2),
        ("B", 191, 3),
    ]
    assert await queue.receive(0.01) == []
    asyncio.get_running_loop().call_later(0.02, lambda: direct.say("A", '{"n": 4}'))
    assert [each.fields["n"] for each in await queue.receive(5.0)] == [4]
    queue.close()
    assert direct.subscribed == {}


async def test_messages_of_another_system_are_dropped() -> None:
    direct = Direct()
    queue = MessageQueue(direct, ["A"], VEHICLE)
    direct.say("A", '{"n": 1}', system_id=VEHICLE + 1)
    direct.say("A", '{"n": 2}')
    assert [each.fields["n"] for each in await queue.receive(1.0)] == [2]


async def test_a_slow_listener_keeps_the_latest_and_no_more() -> None:
    direct = Direct()
    queue = MessageQueue(direct, ["A"], VEHICLE)
    calls = 0
    loop = asyncio.get_running_loop()
    call = loop.call_soon_threadsafe

    def counted(*arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        return call(*arguments)

    loop.call_soon_threadsafe = counted  # type: ignore[method-assign, assignment]
    direct.say("A", *(json.dumps({"n": n}) for n in range(10 * MAX_WAITING)))
    assert calls == 1, "the loop's own queue does not grow either"
    numbers = [each.fields["n"] for each in await queue.receive(1.0)]
    assert numbers == list(range(9 * MAX_WAITING, 10 * MAX_WAITING))


def test_a_loop_that_has_ended_is_no_error() -> None:
    direct = Direct()

    async def listen() -> MessageQueue:
        return MessageQueue(direct, ["A"], VEHICLE)

    queue = asyncio.run(listen())
    direct.say("A", "{}")
    assert len(queue.waiting()) == 1


@pytest.mark.parametrize(
    ("link", "url"),
    [
        ("udpin:0.0.0.0:14550", "udpin://0.0.0.0:14550"),
        ("udpout:10.0.0.2:14550", "udpout://10.0.0.2:14550"),
        ("tcp:localhost:5760", "tcpout://localhost:5760"),
        ("serial:/dev/ttyUSB0:57600", "serial:///dev/ttyUSB0:57600"),
    ],
)
def test_links_are_written_as_mavsdk_writes_them(link: str, url: str) -> None:
    assert mavsdk_url(link) == url


def test_a_board_that_is_not_there_is_no_link() -> None:
    with pytest.raises(ValueError, match="usb:ffff:ffff is not there"):
        mavsdk_url("usb:ffff:ffff")
