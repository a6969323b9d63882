"""`python -m flying_vines` is `flying-vines`."""

from flying_vines.cli.main import main

main()
