"""RC: checks the radio link, and turns moves of the pilot's switch into requests."""
