"""Programs that others wrote, as peers of the service."""
