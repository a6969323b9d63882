"""Routes messages to links. The routes are learnt from the senders on each link."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flying_vines.vehicle.mission.storage import AutopilotKind

AUTOPILOT_COMPONENT = 1
_CAPACITY = 20


@dataclass(frozen=True, slots=True)
class Route:
    """Links to forward a message to; `local`: the autopilot handles the message itself."""

    forward: tuple[str, ...]
    local: bool


class Routes:
    """(system, component) -> link. Routes never expire; a reboot forgets them."""

    def __init__(self, kind: AutopilotKind, system_id: int) -> None:
        self._kind = kind
        self._system_id = system_id
        self._link_of: dict[tuple[int, int], str] = {}

    def learn(self, system: int, component: int, link: str) -> None:
        own = (self._system_id, AUTOPILOT_COMPONENT)
        address = (system, component)
        has_room = address in self._link_of or len(self._link_of) < _CAPACITY
        if system and address != own and has_room:
            self._link_of[address] = link

    def decide(self, source: str, system: int, component: int) -> Route:
        """The route of a message from link `source` to (system, component), where 0 means all."""
        ours = system in (0, self._system_id)
        local = ours and component in (0, AUTOPILOT_COMPONENT)
        if local and system and component:
            return Route((), True)
        forward = self._links(source, self._filter(system, component, ours))
        if not forward and ours and self._kind == "ardupilot":
            # A quirk: ArduPilot itself handles messages for an unknown component of its system.
            local = True
        return Route(forward, local)

    def _links(self, source: str, concerned: Callable[[tuple[int, int]], bool]) -> tuple[str, ...]:
        found = (link for address, link in self._link_of.items() if link != source and concerned(address))
        return tuple(dict.fromkeys(found))

    def _filter(self, system: int, component: int, ours: bool) -> Callable[[tuple[int, int]], bool]:
        def concerned(address: tuple[int, int]) -> bool:
            if system == 0:
                return True
            return address[0] == system and (component in (0, address[1]) or not ours)

        return concerned
