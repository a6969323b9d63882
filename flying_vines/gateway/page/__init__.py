"""A page for a phone or a laptop: how things stand, what happened, and a way to vent. No outside requests.

`door` says who may come in, `crowd` how many, `wish` what they may ask for and how often; none of them knows
a socket. `viewer` talks with one browser, `server` holds the port. `static/` is what the browser loads.
"""

from __future__ import annotations

from flying_vines.gateway.page.server import serve

__all__ = ["serve"]
