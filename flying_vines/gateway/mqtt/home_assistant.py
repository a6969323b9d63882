"""Home Assistant's discovery: one retained message per entity, so that the vehicle appears by itself.

Names and templates: https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from flying_vines.config.config import MqttConfig
from flying_vines.gateway.mqtt.teller import Publication
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
)
_VENT = """{"id": "{{ now().timestamp() }}-{{ range(1000000) | random }}", \
"unix_s": {{ now().timestamp() }}, "command": "vent"}"""


def discovery(mqtt: MqttConfig, topics: Topics, version: str) -> list[Publication]:
    """The discovery messages, if they are wanted. A button that is no longer permitted is removed."""
    if not mqtt.discovery_prefix:
        return []
    name, prefix = (part.replace("/", "_").replace(".", "_") for part in (topics.name, topics.prefix))
    shared: dict[str, Any] = {
        "availability_topic": topics.status,
        "availability_template": "{{ value_json.status }}",
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
        config = shared | {"unique_id": f"{prefix}_{name}_{key}"} | what if what is not None else None
        return Publication(topic, msgspec.json.encode(config) if config else b"", qos=1, retain=True)

    entities = [
        entity(
            "sensor",
            sensor.key,
            {
                "name": sensor.name,
                "state_topic": f"{topics.base}/{sensor.topic}",
                "value_template": f"{{{{ {sensor.template} }}}}",
                "expire_after": 30,
            }
            | sensor.more,
        )
        for sensor in _SENSORS
    ]
    vent = {"name": "Vent", "command_topic": topics.ask, "command_template": _VENT, "qos": 1}
    entities.append(entity("button", "vent", vent if "vent" in mqtt.commands else None))
    return entities
