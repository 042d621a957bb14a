"""Who speaks: elements and their layout in arrays."""
