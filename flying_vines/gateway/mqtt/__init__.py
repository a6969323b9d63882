"""The vehicle on an MQTT broker: its state, what happens, and what the configuration lets people ask for.

`topics` and `payloads` say what is where, `teller` and `asks` decide what is told and done; of the network
`connection` alone knows.
"""

from flying_vines.gateway.mqtt.connection import serve

__all__ = ["serve"]
