"""The serial link between a host and the phloSAR's microcontroller. It is usable without flying_vines."""
