"""MQTT client: publishes state and events, and accepts the requests that the profile permits.

`topics` and `payloads` define the messages, `teller` publishes, and `asks` checks requests. Only `connection`
uses the network.
"""

from flying_vines.gateway.mqtt.connection import serve

__all__ = ["serve"]
