"""The firmware, tested: its core, its image for the chip, and the machines that run it."""
