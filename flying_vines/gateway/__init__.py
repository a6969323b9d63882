"""The status page and the MQTT client, in a process of their own."""
