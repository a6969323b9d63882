"""Imports recordings of any layout as a case that can be diagnosed."""
