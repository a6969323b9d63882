"""Other people's programs as peers of the service."""
