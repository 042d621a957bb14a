"""What boards emit, in levels; this room imports little, because the process of a link waits for it."""
