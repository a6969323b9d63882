"""A page for a phone or a laptop: the state, the events, and a button that vents.

`access` decides who may use the page and how many; it uses no socket. `viewer_session` serves one browser,
`flights` offers the logs, `server` owns the port, and `static/` has the files that the browser loads.
"""

from flying_vines.gateway.page.server import serve

__all__ = ["serve"]
