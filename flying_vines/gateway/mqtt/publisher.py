"""Decides what is published, and when. Stores events until the broker has them. Reads no clock.

Home Assistant's discovery is one retained message per entity, so that the vehicle appears by itself. Names
and templates: https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery
"""

from __future__ import annotations

import secrets
from collections import deque
from typing import Any, Literal, NamedTuple

import msgspec

from flying_vines.config.config import Config
from flying_vines.gateway.messages import GatewayStart, Happened, SnapshotMessage
from flying_vines.gateway.mqtt.payloads import (
    ASKED_WITHIN_S,
    AboutPayload,
    AnswerPayload,
    EventPayload,
    LimitsPayload,
    LostEvent,
    ReservoirPayload,
    SeverityName,
    StatePayload,
    StatusPayload,
    Topics,
)

SILENT_S = 3.0
"""The status becomes `silent` after this time without a snapshot. Ten snapshots a second are normal."""
RESERVOIR_S = 2.0
MAX_STORED_EVENTS = 1000
"""Events stored while the broker is away; above this the oldest are lost."""

_KINDS = {"decision", "notice"}
SEVERITIES: dict[int, SeverityName] = {3: "error", 4: "warning", 5: "notice", 6: "info"}


class Now(NamedTuple):
    """One moment on two clocks: the events' monotonic clock, and the computer's clock, which may be set."""

    t: float
    unix_s: float

    def unix_of(self, t: float) -> float:
        return round(self.unix_s - (self.t - t), 3)


class Publication(NamedTuple):
    """One message to the broker."""

    topic: str
    payload: bytes
    qos: Literal[0, 1] = 0
    retain: bool = False


class Pending(NamedTuple):
    """An event to publish. Pass it to `published` when the broker has it."""

    number: int
    lost: int
    publication: Publication


class Events:
    """Stores up to `max_events` numbered events in order. A `LostEvent` replaces the dropped ones.

    An event gets its Unix time when it is published: without a network, the computer's clock may be wrong.
    """

    def __init__(self, topic: str, run: str, max_events: int) -> None:
        self._topic = topic
        self._run = run
        self._stored: deque[tuple[int, Happened]] = deque(maxlen=max_events)
        self._number = 0
        self._lost = 0

    def __len__(self) -> int:
        return len(self._stored)

    def take(self, happened: Happened) -> None:
        self._lost += len(self._stored) == self._stored.maxlen
        self._number += 1
        self._stored.append((self._number, happened))

    def first(self, now: Now) -> Pending | None:
        """The next event to publish. Returns the same event until `published` is called."""
        if not self._stored:
            return None
        number, happened = self._stored[0]
        event: EventPayload
        if self._lost:
            number -= 1
            event = LostEvent(unix_s=now.unix_s, run=self._run, number=number, count=self._lost)
        else:
            event = self._event(now, number, happened)
        return Pending(number, self._lost, Publication(self._topic, msgspec.json.encode(event), qos=1))

    def published(self, pending: Pending) -> None:
        """The broker has the event. Meanwhile newer events may have replaced it here."""
        if pending.lost:
            self._lost -= pending.lost
        elif self._stored[0][0] == pending.number:
            self._stored.popleft()
        else:
            self._lost -= 1

    def _event(self, now: Now, number: int, happened: Happened) -> EventPayload:
        fields: dict[str, Any] = msgspec.json.decode(happened.fields)
        if happened.what == "notice":
            fields["severity"] = SEVERITIES[fields["severity"]]
        fields |= {
            "event": happened.what,
            "unix_s": now.unix_of(fields["t"]),
            "run": self._run,
            "number": number,
        }
        event: EventPayload = msgspec.convert(fields, EventPayload)
        return event


class Publisher:
    """Makes the publications of one vehicle."""

    def __init__(self, start: GatewayStart, topics: Topics) -> None:
        self.topics = topics
        self._run = secrets.token_hex(4)
        self._mqtt = start.config.mqtt
        self._start = start
        self.events = Events(topics.event, self._run, MAX_STORED_EVENTS)
        self._latest: SnapshotMessage | None = None
        self._seen_at = -SILENT_S
        self._status: Literal["online", "silent"] = "silent"
        self._reservoir_at = -RESERVOIR_S

    def take(self, t: float, news: Happened | SnapshotMessage) -> None:
        if isinstance(news, SnapshotMessage):
            self._latest, self._seen_at = news, t
        elif news.what in _KINDS:
            self.events.take(news)

    def last_will(self, now: Now) -> Publication:
        """The message that the broker publishes when we are gone."""
        return self._retained(self.topics.status, StatusPayload(unix_s=now.unix_s, status="offline"))

    def greeting(self, now: Now) -> list[Publication]:
        """The first messages of each connection: the broker may have lost the retained ones."""
        self._reservoir_at = -RESERVOIR_S
        self._status = self._present_status(now)
        return [self._status_message(now), self._retained(self.topics.about, self.about(now))]

    def due(self, now: Now) -> list[Publication]:
        """The messages to publish now: a new status, the state, the reservoir. Call it at the state rate."""
        publications = []
        status = self._present_status(now)
        if status != self._status:
            self._status = status
            publications.append(self._status_message(now))
        if self._latest is not None:
            snapshot = msgspec.json.decode(self._latest.snapshot)
            t = snapshot["t"]
            # `t` is not rounded, so that a slightly newer fault does not count as seen.
            seen = _rounded(snapshot) | {"t": t, "unix_s": now.unix_of(t)}
            publications.append(self._plain(self.topics.state, msgspec.convert(seen, StatePayload)))
            if now.t - self._reservoir_at >= RESERVOIR_S:
                self._reservoir_at = now.t
                publications.append(
                    self._plain(self.topics.reservoir, msgspec.convert(seen, ReservoirPayload))
                )
            self._latest = None
        return publications

    def answer(self, answer: AnswerPayload) -> Publication:
        return Publication(self.topics.answer, msgspec.json.encode(answer), qos=1)

    def about(self, now: Now) -> AboutPayload:
        config = self._start.config
        limits = config.limits
        return AboutPayload(
            unix_s=now.unix_s,
            name=self.topics.name,
            flying_vines=self._start.version,
            run=self._run,
            profiles=tuple(config.profiles),
            limits=LimitsPayload(
                limits.max_kPa,
                config.vine.bend_curve().max_deg,
                limits.max_rate_kPa_per_s,
                limits.max_bent_s,
                limits.overpressure_kPa,
            ),
            commands=self._mqtt.commands,
            asked_within_s=ASKED_WITHIN_S,
            rate_Hz=self._mqtt.rate_Hz,
        )

    def _present_status(self, now: Now) -> Literal["online", "silent"]:
        return "online" if now.t - self._seen_at < SILENT_S else "silent"

    def _status_message(self, now: Now) -> Publication:
        return self._retained(self.topics.status, StatusPayload(unix_s=now.unix_s, status=self._status))

    @staticmethod
    def _retained(topic: str, payload: StatusPayload | AboutPayload) -> Publication:
        return Publication(topic, msgspec.json.encode(payload), qos=1, retain=True)

    @staticmethod
    def _plain(topic: str, payload: StatePayload | ReservoirPayload) -> Publication:
        return Publication(topic, msgspec.json.encode(payload))


def _rounded(value: Any) -> Any:
    """Rounds to three decimals: no sensor is better, and each digit is sent by radio."""
    if isinstance(value, float):
        return round(value, 3)
    if isinstance(value, dict):
        return {key: _rounded(inner) for key, inner in value.items()}
    return value


# Home Assistant.


class _Sensor(NamedTuple):
    key: str
    name: str
    topic: str
    template: str
    more: dict[str, object]


_MEASUREMENT: dict[str, object] = {"state_class": "measurement", "suggested_display_precision": 1}
_PRESSURE = _MEASUREMENT | {"unit_of_measurement": "kPa", "device_class": "pressure"}
_MINUTES = _MEASUREMENT | {"unit_of_measurement": "min", "device_class": "duration"}
_SENSORS = (
    _Sensor("reservoir", "Reservoir", "state", "value_json.reservoir_kPa", _PRESSURE),
    _Sensor("vine", "Vine pressure", "state", "value_json.cv_kPa", _PRESSURE),
    _Sensor("bend", "Bend", "state", "value_json.bend_deg", _MEASUREMENT | {"unit_of_measurement": "°"}),
    _Sensor("cycles", "Cycles left", "reservoir", "(value_json.cycles or {}).get('expected')", _MEASUREMENT),
    _Sensor("air_minutes", "Air lasts", "reservoir", "(value_json.cycles or {}).get('minutes')", _MINUTES),
    _Sensor("doing", "Doing", "state", "value_json.doing", {}),
    _Sensor("waiting", "Waiting for", "state", "(value_json.waiting or {}).get('awaited', 'nothing')", {}),
)
_ON_OFF: dict[str, object] = {"payload_on": "True", "payload_off": "False"}
_BINARY_SENSORS = (
    _Sensor(
        *("problem", "Problem", "state", "value_json.safe_state | length > 0"),
        _ON_OFF | {"device_class": "problem"},
    ),
    _Sensor("armed", "Vehicle armed", "state", "value_json.armed", _ON_OFF),
    _Sensor("pneumatics", "Pneumatics armed", "state", "value_json.pneumatics_armed", _ON_OFF),
)


def discovery(config: Config, topics: Topics, version: str) -> list[Publication]:
    """The discovery messages; none without a prefix. An entity that is no longer permitted is removed."""
    mqtt = config.mqtt
    if not mqtt.discovery_prefix:
        return []
    name, prefix = (part.replace("/", "_").replace(".", "_") for part in (topics.name, topics.prefix))
    shared: dict[str, Any] = {
        "availability_topic": topics.status,
        # Home Assistant only knows online and offline: "silent" would leave the old state.
        "availability_template": "{{ 'online' if value_json.status == 'online' else 'offline' }}",
        "device": {
            "identifiers": [f"{prefix}_{name}"],
            "name": topics.name,
            "model": "Flying Vines",
            "sw_version": version,
        },
        "origin": {"name": "Flying Vines", "sw_version": version},
    }

    def entity(kind: str, key: str, what: dict[str, Any] | None) -> Publication:
        # The name is a whole topic level, because a broker's access list cannot match a part of a level.
        topic = f"{mqtt.discovery_prefix}/{kind}/{name}/{prefix}_{key}/config"
        whole = shared | {"unique_id": f"{prefix}_{name}_{key}"} | what if what is not None else None
        return Publication(topic, msgspec.json.encode(whole) if whole else b"", qos=1, retain=True)

    entities = [
        entity(
            kind,
            sensor.key,
            {
                "name": sensor.name,
                "state_topic": f"{topics.base}/{sensor.topic}",
                "value_template": f"{{{{ {sensor.template} }}}}",
                "expire_after": 30,
            }
            | sensor.more,
        )
        for kind, sensors in (("sensor", _SENSORS), ("binary_sensor", _BINARY_SENSORS))
        for sensor in sensors
    ]
    for kind, key, command, what in (
        ("number", "bend_to", "bend", _bend(config)),
        ("select", "profile", "profile", _profile(config)),
        ("button", "vent", "vent", {"name": "Vent", "command_template": _request("vent")}),
    ):
        asks = {"command_topic": topics.ask, "qos": 1} | what
        if kind != "button":
            asks["state_topic"] = topics.state
        entities.append(entity(kind, key, asks if command in mqtt.commands else None))
    return entities


def _request(command: str, more: str = "") -> str:
    """The template of a request to the vehicle."""
    return (
        '{"id": "{{ now().timestamp() }}-{{ range(1000000) | random }}", '
        f'"unix_s": {{{{ now().timestamp() }}}}, "command": "{command}"{more}}}'
    )


def _bend(config: Config) -> dict[str, Any]:
    curve = config.vine.bend_curve()
    return {
        "name": "Bend to",
        "unit_of_measurement": "°",
        "min": curve.min_deg,
        "max": curve.max_deg,
        "step": 1,
        "value_template": "{{ value_json.bend_deg }}",
        "command_template": _request("bend", ', "value": {{ value }}'),
    }


def _profile(config: Config) -> dict[str, Any]:
    """Between profiles the state is "None", which Home Assistant shows as unknown."""
    names = list(config.profiles)
    return {
        "name": "Profile",
        "options": names,
        "value_template": f"{{{{ value_json.doing if value_json.doing in {names} else 'None' }}}}",
        "command_template": _request("profile", ', "name": {{ value | tojson }}'),
    }
