"""Uses mavsdk to find a vehicle on a link, to transfer its mission, and to queue its messages."""

from __future__ import annotations

import asyncio
import json
import math
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from firmware_link.find import BoardNotFoundError, UsbBoard
from flying_vines.config.address import DEFAULT_BAUD, SerialAddress, parse_address
from flying_vines.files.extras import install_command
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem, has_place

FOUND_WITHIN_S = 10.0
HEARTBEAT_WITHIN_S = 3.0
POLL_S = 0.05
ANSWER_WITHIN_S = 15.0
"""Timeout of a command or of one transfer step; mavsdk itself repeats for some seconds before it fails."""
DOWNLOADED_WITHIN_S = 300.0
"""Long enough for several hundred items over a slow radio; mavsdk fails earlier if the vehicle is silent."""
MAX_WAITING = 500
"""Maximum messages stored for a slow listener; the oldest are dropped."""

_CALLBACKS: list[Any] = []
"""Keeps mavsdk's callbacks alive. mavsdk 4.1.0 frees them when it is destroyed; a callback that runs at this
moment would crash the process."""

_RESULTS = {
    1: "the vehicle reports an error",
    2: "the vehicle does not accept its frame",
    3: "the vehicle does not know this command in a mission",
    4: "the vehicle has no room for it",
    5: "the vehicle reports an invalid number in it",
    **{
        6 + n: f"the vehicle does not accept its {name}"
        for n, name in enumerate(("param1", "param2", "param3"))
    },
    9: "the vehicle does not accept its param4",
    10: "the vehicle does not accept its x (latitude)",
    11: "the vehicle does not accept its y (longitude)",
    12: "the vehicle does not accept its z (altitude)",
    13: "the vehicle received an item out of sequence",
    14: "the vehicle accepts no mission now",
    15: "the vehicle cancelled the upload",
}


class VehicleLinkError(Exception):
    """The vehicle cannot be reached, does not answer, or has no mission. The text is one line."""


class UploadRefused(Exception):
    """The vehicle refused the mission. `seq` is the refused item; None if the vehicle requested no item."""

    def __init__(self, seq: int | None, why: str) -> None:
        super().__init__(why)
        self.seq = seq
        self.why = why


@dataclass(frozen=True, slots=True)
class ReceivedMessage:
    """A message of any component of the vehicle, with its fields by name."""

    name: str
    component: int
    fields: dict[str, Any]


def mavsdk_url(link: str) -> str:
    """A link in mavsdk's notation. Raises `ValueError` if it is invalid, or if its board is missing."""
    address = parse_address(link)
    if isinstance(address, UsbBoard):
        try:
            return f"serial://{address.find()}:{DEFAULT_BAUD}"
        except BoardNotFoundError as error:
            raise ValueError(str(error)) from None
    if isinstance(address, SerialAddress):
        return f"serial://{address.path}:{address.baud}"
    if address.peer:
        raise ValueError(f"'{link}': ?peer= is only for the service; remove it")
    scheme = "tcpout" if address.kind == "tcp" else address.kind
    return f"{scheme}://{address.host}:{address.port}"


@asynccontextmanager
async def vehicle(link: str, within_s: float = FOUND_WITHIN_S) -> AsyncIterator[MissionVehicle]:
    """The first autopilot found on `link`. Raises `VehicleLinkError` if there is none within the time."""
    try:
        url = mavsdk_url(link)
    except ValueError as error:
        raise VehicleLinkError(str(error)) from None
    mavsdk = _mavsdk()
    configuration = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
    async with mavsdk.Mavsdk(configuration) as client:
        try:
            async with asyncio.timeout(within_s):
                await client.add_any_connection(url)
        except (mavsdk.MavsdkConnectionError, TimeoutError):
            raise VehicleLinkError(
                f"{link}: cannot be opened: does the port exist, and is it free?"
            ) from None
        system = await client.first_autopilot(within_s)
        if system is None:
            raise VehicleLinkError(f"{link}: no vehicle found within {within_s:g} s")
        kind = await _kind(system)
        if kind is None:
            raise VehicleLinkError(f"{link}: the vehicle is neither ArduPilot nor PX4")
        found = MissionVehicle(system._system, kind, await system.get_system_id())
        try:
            yield found
        finally:
            found.close()


_KINDS = {kind.upper(): kind for kind in AUTOPILOTS}
"""Our kinds, by mavsdk's names for them."""


async def _kind(system: Any) -> AutopilotKind | None:
    """The autopilot's kind, or None if no heartbeat comes.

    mavsdk finds an autopilot by any message, but learns its kind only from a heartbeat.
    """
    for _ in range(round(HEARTBEAT_WITHIN_S / POLL_S)):
        kind = _KINDS.get((await system.autopilot_type()).name)
        if kind is not None:
            return kind
        await asyncio.sleep(POLL_S)
    return None


def _mavsdk() -> Any:
    """mavsdk without log output. Raises `VehicleLinkError` if it is missing or does not run here."""
    try:
        import mavsdk.asyncio
        from mavsdk.logging import log_subscribe
    except ModuleNotFoundError:
        remedy = install_command("missions")
        raise VehicleLinkError(f"mavsdk is missing: {remedy}, on 64-bit systems") from None
    except Exception as error:  # mavsdk's own exception class is in the library that failed to load
        raise VehicleLinkError(f"mavsdk does not run here: {str(error).splitlines()[0]}") from None

    log_subscribe(lambda level, message, file, line: True)
    return mavsdk.asyncio


class MessageQueue:
    """Receives the messages of one vehicle with the given names. At most MAX_WAITING wait for the reader.

    Messages of other systems are dropped here: another drone on the same network must not end a watch. mavsdk
    4.1.0 does not deliver such messages, but its documentation does not promise that.
    """

    def __init__(self, direct: Any, names: Sequence[str], system_id: int) -> None:
        self._direct = direct
        self._system_id = system_id
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[Any] = deque(maxlen=MAX_WAITING)
        self._arrived = asyncio.Event()
        self._called = False
        self._handles = [direct.subscribe_message(name, self._take) for name in names]

    def _take(self, message: Any, _: object) -> None:
        """Runs in a thread of mavsdk. Several messages before `_wake` cause only one call of the event
        loop."""
        if message.system_id != self._system_id:
            return
        self._waiting.append(message)
        if not self._called:
            self._called = True
            with suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self._called = False
        self._arrived.set()

    def waiting(self) -> list[ReceivedMessage]:
        """The messages since the last call."""
        found = []
        while self._waiting:
            message = self._waiting.popleft()
            with suppress(json.JSONDecodeError):
                fields = json.loads(message.fields_json)
                found.append(ReceivedMessage(message.message_name, message.component_id, fields))
        return found

    async def receive(self, within_s: float) -> list[ReceivedMessage]:
        """Waits for a message. Returns all that have arrived; empty if none came within the time."""
        with suppress(TimeoutError):
            async with asyncio.timeout(within_s):
                while not self._waiting:
                    self._arrived.clear()
                    await self._arrived.wait()
        return self.waiting()

    def close(self) -> None:
        for handle in self._handles:
            self._direct.unsubscribe_message(handle)
        self._handles = []


class MissionVehicle:
    """An autopilot that mavsdk has found."""

    def __init__(self, system: Any, kind: AutopilotKind, system_id: int) -> None:
        from mavsdk.plugins.mavlink_direct import MavlinkDirect
        from mavsdk.plugins.mission_raw import MissionRaw

        self.kind: AutopilotKind = kind
        self.system_id = system_id
        self._direct = MavlinkDirect(system)
        self._mission = MissionRaw(system)
        self._queues: list[MessageQueue] = []

    def listen(self, *names: str) -> MessageQueue:
        """Receive messages from now on, until `close`."""
        queue = MessageQueue(self._direct, names, self.system_id)
        self._queues.append(queue)
        return queue

    def close(self) -> None:
        for queue in self._queues:
            queue.close()
        for plugin in (self._direct, self._mission):
            _CALLBACKS.extend(getattr(plugin, "_callbacks", ()))

    async def upload(self, items: Sequence[MissionItem], progress: Callable[[float], None]) -> None:
        """Send a whole mission; `progress` gets the transferred share, 0 to 1.

        Raises:
            UploadRefused: the vehicle refused it.
            VehicleLinkError: the vehicle stopped answering.
        """
        from mavsdk.plugins.mission_raw import MissionPlan, MissionRawResult

        queue = self.listen("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK")
        steps: asyncio.Queue[tuple[Any, float]] = asyncio.Queue()  # one step per item
        loop = asyncio.get_running_loop()

        def step(result: Any, data: Any, _: object = None) -> None:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(steps.put_nowait, (result, data.progress))

        self._mission.upload_mission_with_progress_async(MissionPlan([_to_raw(item) for item in items]), step)
        while True:
            try:
                async with asyncio.timeout(ANSWER_WITHIN_S):
                    result, done = await steps.get()
            except TimeoutError:
                result, done = MissionRawResult.TIMEOUT, 0.0
            if result == MissionRawResult.NEXT:
                progress(done)
            elif result == MissionRawResult.SUCCESS:
                progress(1.0)
                return
            elif result == MissionRawResult.TIMEOUT:
                raise VehicleLinkError(
                    "the vehicle stopped answering during the upload; its mission is now unknown"
                )
            else:
                raise await _refusal(queue, result)

    async def download(self) -> list[MissionItem]:
        """The vehicle's mission. Raises `VehicleLinkError` if it cannot be read."""
        from mavsdk.plugins.mission_raw import MissionRawResult

        result, raw = await _answer(self._mission.download_mission_async, DOWNLOADED_WITHIN_S)
        if result != MissionRawResult.SUCCESS:
            reason = result.name.lower().replace("_", " ") if result else "timeout"
            raise VehicleLinkError(f"the mission cannot be read from the vehicle: {reason}")
        return [_from_raw(item) for item in raw]

    async def command(self, command: int, *params: float, component: int = 1) -> int | None:
        """Send a COMMAND_LONG. Returns its MAV_RESULT, or None without an answer."""
        from mavsdk.plugins.mavlink_direct import MavlinkDirectResult, MavlinkMessage

        fields: dict[str, Any] = {"target_system": self.system_id, "target_component": component}
        fields |= {"command": command, "confirmation": 0}
        fields |= {f"param{n}": value for n, value in enumerate((*params, *(0.0,) * 7)[:7], start=1)}
        message = MavlinkMessage("COMMAND_LONG", 0, 0, self.system_id, component, json.dumps(fields))
        result, answer = await _answer(partial(self._direct.send_command_async, message), ANSWER_WITHIN_S)
        if result != MavlinkDirectResult.SUCCESS:
            return None
        mav_result: int = json.loads(answer.fields_json)["result"]
        return mav_result


async def _answer(start: Callable[[Callable[..., None]], None], within_s: float) -> tuple[Any, Any]:
    """The result of an asynchronous mavsdk call; (None, None) after a timeout.

    mavsdk's blocking calls cannot be used: a call that runs when mavsdk is destroyed never returns.
    """
    loop = asyncio.get_running_loop()
    ended: asyncio.Future[tuple[Any, Any]] = loop.create_future()

    def settle(result: Any, data: Any) -> None:
        if not ended.done():
            ended.set_result((result, data))

    def called_back(result: Any, data: Any, _: object = None) -> None:
        with suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(settle, result, data)

    start(called_back)
    try:
        async with asyncio.timeout(within_s):
            return await ended
    except TimeoutError:
        return None, None


async def _refusal(queue: MessageQueue, result: Any) -> UploadRefused:
    """The refused item and the reason, from the vehicle's own messages; mavsdk reports neither."""
    requested: int | None = None
    for _ in range(10):
        for message in await queue.receive(0.1):
            if message.name == "MISSION_ACK":
                why = _RESULTS.get(message.fields["type"], f"MAV_MISSION_RESULT {message.fields['type']}")
                return UploadRefused(requested, why)
            requested = message.fields["seq"]
    return UploadRefused(requested, result.name.lower().replace("_", " "))


def _to_raw(item: MissionItem) -> Any:
    from mavsdk.plugins.mission_raw import MissionItem as RawItem

    scale = 1e7 if has_place(item.command, item.frame) else 1.0
    x, y = (round(value * scale) if math.isfinite(value) else 0 for value in item.params[4:6])
    is_first, goes_on = int(item.seq == 0), int(item.autocontinue)
    return RawItem(
        *(item.seq, item.frame, item.command, is_first, goes_on), *item.params[:4], x, y, item.params[6], 0
    )


def _from_raw(raw: Any) -> MissionItem:
    scale = 1e7 if has_place(raw.command, raw.frame) else 1.0
    params = (raw.param1, raw.param2, raw.param3, raw.param4, raw.x / scale, raw.y / scale, raw.z)
    return MissionItem(raw.seq, raw.command, params, raw.frame, bool(raw.current), bool(raw.autocontinue))
