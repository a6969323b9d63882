"""Other programs as peers of the service."""
