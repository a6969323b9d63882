"""The status page and the MQTT client, in a separate process."""
