"""Missions with vine items: built, checked, budgeted, put on a vehicle and followed."""
