"""Missions with vine items: files that ground stations read."""
