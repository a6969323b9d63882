"""MQTT client: publishes state and events, and accepts the requests that the configuration permits.

`payloads` defines topics and messages, `publisher` makes the messages, and `requests` checks requests.
`broker` has what a connection needs and what its errors mean. Only `connection` uses the network.
"""

from flying_vines.gateway.mqtt.connection import serve

__all__ = ["serve"]
