"""The terminal views: `screen` shows our own service, `remote_view` another one through its page.

For `remote_view`, `page_protocol` converts the page's messages to snapshots and events, without socket or
clock. `page_socket` is the socket, which reconnects. `keys` reads the keyboard. `vine_sketch` draws a vine.
"""
