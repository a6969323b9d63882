"""The guides agree with the code, and their links and commands work."""
