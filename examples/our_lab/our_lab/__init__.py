"""What our lab adds to Flying Vines."""
