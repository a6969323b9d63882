"""The vehicle side: MAVLink in, intents and telemetry out."""
