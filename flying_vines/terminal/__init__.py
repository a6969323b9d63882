"""The terminal view: `screen` shows our own service, the other modules a remote one through its page.

`page_protocol` converts the page's messages to snapshots and events; it has no socket and no clock.
`page_socket` is the socket, which reconnects; `keys` reads the keyboard; `remote_view` connects them.
"""
