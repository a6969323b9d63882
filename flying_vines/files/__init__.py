"""Files that somebody else wrote: their size and depth are bounded, whatever they say of themselves."""
