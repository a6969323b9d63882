"""A page for a phone or a laptop: the state, the events, and a button that vents.

`access` decides who may use the page, `connections` limits their number, and `request` defines a browser's
requests; none of them uses a socket. `viewer_session` serves one browser, `server` owns the port, and
`static/` has the files that the browser loads.
"""

from __future__ import annotations

from flying_vines.gateway.page.server import serve

__all__ = ["serve"]
