"""The doctor's edge: facts of this machine, from files, sockets and the clock. Nothing is judged here."""
