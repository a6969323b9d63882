"""Flying Vines: a soft robot arm on a drone, bent by a switch, a mission item or a command."""
