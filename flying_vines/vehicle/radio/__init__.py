"""RC: whether it can be trusted, and what the pilot's switch asks for."""
