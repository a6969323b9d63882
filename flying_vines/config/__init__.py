"""The configuration file, read into frozen structures."""
