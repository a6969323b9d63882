"""Home Assistant's discovery: one retained message per entity, so that the vehicle appears by itself.

Names and templates: https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from flying_vines.config.config import Config
from flying_vines.gateway.mqtt.publisher import Publication
from flying_vines.gateway.mqtt.topics import Topics


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
