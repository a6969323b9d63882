"""The edge: feeds the core from sockets, the serial port and the clock."""
