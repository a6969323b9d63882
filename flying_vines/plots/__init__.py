"""What all figures share: their style, and the drawing of a vine."""
