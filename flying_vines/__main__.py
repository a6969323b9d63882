"""`python -m flying_vines` is `flying-vines`."""

from flying_vines.cli import main

main()
