"""Mission items: what they are, what an autopilot keeps of them, and seeing that one ran."""
