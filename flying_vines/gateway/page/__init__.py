"""A page for a phone or a laptop: the state, the events, and a button that vents.

`access` says who may use the page, `connections` how many may, `request` what a browser may ask for; none of
them knows a socket. `viewer` talks with one browser, `server` holds the port, and `static/` is what the
browser loads.
"""

from __future__ import annotations

from flying_vines.gateway.page.server import serve

__all__ = ["serve"]
