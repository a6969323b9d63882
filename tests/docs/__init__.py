"""The guides: what they state of commands and keys is the code's, and what they point to is there."""
