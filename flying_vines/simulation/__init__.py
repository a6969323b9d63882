"""A fake autopilot and a fake phloSAR: shipped, and used by the demo, the replay and the tests."""
