"""The core decides: time-stamped events in, actions out. It reads no clock, opens no port, awaits nothing."""
