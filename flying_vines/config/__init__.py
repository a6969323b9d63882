"""Reads the configuration file into frozen structures."""
