"""Compares recorded runs of a rig with the baseline simulation and finds the cause of the difference."""
