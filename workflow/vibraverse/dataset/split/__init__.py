"""Which side of the splits an object is on."""
