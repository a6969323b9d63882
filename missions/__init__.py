"""Missions with vine items: build, check, budget, upload and follow them."""
