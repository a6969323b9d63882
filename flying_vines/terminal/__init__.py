"""The terminal view: `screen` shows our own service; the other modules show another one by its page.

`story` converts the page's messages to snapshots and events; it has no socket and no clock. `line` is the
socket, which reconnects; `keys` reads the keyboard; `watching` connects them.
"""
