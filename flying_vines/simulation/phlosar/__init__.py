"""The simulated phloSAR: the firmware on the plant, behind a pseudo-terminal."""
