"""Installs and removes the service on a drone: files for systemd and udev."""
