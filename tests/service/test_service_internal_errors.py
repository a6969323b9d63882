"""Failures around the core of a running service: links, tasks, bytes and files."""

from __future__ import annotations

import asyncio
import dataclasses
import math
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
from fault_catalogue.black_box import STEP_S, BlackBox
from fault_catalogue.catalogue import ROWS
from real_time import real_time
from service_bench import Bench, on_bench
from waiting import until

from firmware_link import protocol
from firmware_link.actuator import PhlosarLine
from flying_vines.config import config
from flying_vines.core.crash_safe_core import SHUTDOWN_TEXT
from flying_vines.core.events import Action, Decision, InternalError
from flying_vines.core.watcher import EachAction
from flying_vines.service.service import Service
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.vehicle.mavlink.link import UdpLink
from flying_vines.vehicle.notice import Notice
from flying_vines.vine.intent import BendTo

pytestmark = real_time


@dataclasses.dataclass
class Serving:
    """A service that has bent the vine."""

    bench: Bench
    service: Service
    seen: list[Action]
    box: BlackBox

    def texts(self) -> list[str]:
        return [action.text for action in self.seen if isinstance(action, Notice)]

    async def shut_down(self) -> None:
        """The vine is vented by a command, the ground station gets the reason once, and nothing bends."""
        await until(self.bench.vented, "vented")
        await until(lambda: self.bench.ground.texts.count(SHUTDOWN_TEXT) == 1, "the ground station reads it")
        self.bench.ground.values.clear()
        for pulse in (1000, 2000):
            self.bench.autopilot.set_rc(9, pulse)
            await asyncio.sleep(0.4)
        answer = self.service.ask("page", BendTo(20.0))
        assert (answer.safety, self.bench.vented()) == ("refused", True)
        assert not self.bench.phlosar.firmware.faults  # the dead-man did not act
        assert self.bench.ground.texts.count(SHUTDOWN_TEXT) == 1
        assert [a for a in self.seen if isinstance(a, InternalError) and "unexpected" in a.trace]


@pytest.fixture
async def serving() -> AsyncIterator[Serving]:
    async with on_bench(FakeAutopilot("ardupilot")) as bench:
        box = BlackBox(bench.phlosar)
        seen: list[Action] = []
        service = Service(config.parse(bench.configuration, "test"), (EachAction(seen.append),))
        running = asyncio.create_task(service.run())
        await until(lambda: service.core.snapshot(service.now).switch_position == 0, "RC is accepted")
        await bench.bend()
        yield Serving(bench, service, seen, box)
        service.stop()
        await running


def raising(*arguments: object, **named: object) -> Any:
    raise RuntimeError("unexpected")


def break_callback(service: Service, patch: pytest.MonkeyPatch) -> None:
    """Break the link's callback for a datagram."""
    link = service._vehicle
    assert isinstance(link, UdpLink)
    patch.setattr(link, "_on_bytes", raising)
    asyncio.get_running_loop().call_soon(link.datagram_received, b"x", ("127.0.0.1", 1))


BREAKS: dict[str, Callable[[Service, pytest.MonkeyPatch], None]] = {
    "the core": lambda service, patch: patch.setattr(service.core._core._safety, "watch", raising),
    "vehicle bytes": lambda service, patch: patch.setattr(service._mavlink, "decode", raising),
    "phloSAR bytes": lambda service, patch: patch.setattr(service._serial, "decode", raising),
    "messages to the phloSAR": lambda service, patch: patch.setattr(service._serial, "encode", raising),
    "a link's callback": break_callback,
}


@pytest.mark.parametrize(
    "broken",
    [
        "the core",
        *(pytest.param(name, marks=pytest.mark.long) for name in list(BREAKS)[1:]),
    ],
)
async def test_an_error_that_could_affect_a_setpoint_is_a_commanded_shutdown(
    serving: Serving, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    began_s = serving.bench.phlosar.now_s
    BREAKS[broken](serving.service, monkeypatch)
    await serving.shut_down()
    allowed_ms = ROWS["internal_error"].allowed_ms
    assert allowed_ms is not None and serving.box.unsafe_s is not None
    to_safe_ms = 1000 * (serving.box.unsafe_s + STEP_S - began_s)
    assert to_safe_ms <= allowed_ms


@pytest.mark.long
async def test_a_link_that_ends_is_a_commanded_shutdown_and_starts_again(serving: Serving) -> None:
    (task,) = (task for task in asyncio.all_tasks() if task.get_name() == "vehicle link")
    task._fut_waiter.set_exception(RuntimeError("unexpected"))  # type: ignore[attr-defined]
    await serving.shut_down()
    await until(lambda: "CV_KPA" in serving.bench.ground.values, "the values are back")


@pytest.mark.long
async def test_values_that_cannot_be_sent_are_only_reported(
    serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    encode = serving.service._mavlink.encode

    def without_values(message: Any, system_id: int) -> bytes:
        return raising() if message.get_type() == "NAMED_VALUE_FLOAT" else encode(message, system_id)

    monkeypatch.setattr(serving.service._mavlink, "encode", without_values)
    await until(
        lambda: "Vine: named values failed, flight goes on" in serving.bench.ground.texts, "the text arrives"
    )
    await asyncio.sleep(0.5)
    assert serving.bench.bent()
    assert serving.bench.ground.texts.count("Vine: named values failed, flight goes on") == 1


@pytest.mark.long
async def test_a_background_task_that_fails_is_reported_and_starts_again(
    serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = serving.service
    monkeypatch.setattr("flying_vines.service.service.RESTART_S", 0.1)
    written = asyncio.Event()
    service._store("whatever", raising)
    await until(lambda: "Vine: file storage failed, flight goes on" in serving.texts(), "the text arrives")
    await asyncio.sleep(0.2)
    service._store("whatever", written.set)
    await until(written.is_set, "written by the restarted task")
    assert serving.bench.bent()


@pytest.mark.long
async def test_absurd_telemetry_vents_and_the_service_continues(serving: Serving) -> None:
    latest = serving.service.core._core._firmware.telemetry
    assert latest is not None
    made_ms = latest.device_time_ms
    for value in (1e30, 1e20, 1e12, -1e30, math.nan, math.inf):
        for field in ("cv_kPa", "reservoir_kPa", "setpoint_kPa"):
            for _ in range(2):
                made_ms += 1
                absurd = dataclasses.replace(latest, device_time_ms=made_ms, **{field: value})  # type: ignore[arg-type]
                serving.service._firmware_bytes(protocol.encode(absurd, 0))
    await until(serving.bench.vented, "vented")
    await until(
        lambda: any("sensor reads" in text for text in serving.bench.ground.texts), "the text arrives"
    )
    assert SHUTDOWN_TEXT not in serving.texts()
    assert [a for a in serving.seen if isinstance(a, Decision) and a.what == {"loss": "sensor"}]


def test_a_vent_can_be_sent_without_any_encoder() -> None:
    (message,) = protocol.Codec().decode(PhlosarLine.vent)
    assert isinstance(message, protocol.Vent)
