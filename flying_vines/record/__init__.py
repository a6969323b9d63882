"""What happened, for people: the flight log and its picture."""
