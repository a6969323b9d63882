"""The serial link between a host and the phloSAR's microcontroller. Usable by itself."""
