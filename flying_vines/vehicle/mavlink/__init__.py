"""MAVLink bytes, frames, messages, signing and links."""
