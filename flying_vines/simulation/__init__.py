"""Simulated autopilot and phloSAR, for users, the demo, the replay and the tests."""
