"""The flight log: its recorder, its reader, tables and pictures."""
