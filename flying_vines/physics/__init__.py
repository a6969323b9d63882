"""Pure physics of the phloSAR. It imports no other part of Flying Vines."""
