"""A service that runs elsewhere or under systemd, shown on a terminal through its page's socket.

`story` makes of its messages what the service's own terminal shows; it knows no socket and no clock. `line`
is the socket, opened again whenever it is lost; `keys` is the keyboard; `watching` puts them together.
"""
