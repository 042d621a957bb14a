"""Elements, and their layout in boards and arrays."""
