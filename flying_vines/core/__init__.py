"""The core decides: time-stamped events in, actions out. No clock, port or await."""
