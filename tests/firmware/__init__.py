"""Tests of the firmware: its core, its image for the chip, and simulated and emulated boards."""
