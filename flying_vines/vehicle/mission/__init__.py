"""Mission items: their form, their storage in the autopilot, and their execution."""
