"""A day in the life of a new user, which a person can watch and a test checks."""
