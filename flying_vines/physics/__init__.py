"""Pure physics of the phloSAR. Imports nothing of ours."""
