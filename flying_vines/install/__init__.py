"""The service on a drone: what systemd and udev must know of it, shown, put there and undone."""
