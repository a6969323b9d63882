"""The vine: bend angle, pressure, and pressure profiles over time."""
