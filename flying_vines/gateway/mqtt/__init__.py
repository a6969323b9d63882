"""MQTT client: publishes state and events, and accepts the requests that the configuration permits.

`topics` and `payloads` define the messages, `publisher` makes them, and `requests` checks requests. Only
`connection` uses the network.
"""

from flying_vines.gateway.mqtt.connection import serve

__all__ = ["serve"]
