"""The way out to people: a page and a broker, in a process of their own."""
