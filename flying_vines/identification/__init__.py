"""Recorded runs of a rig against the baseline simulation: what differs in the rig, and how surely."""
