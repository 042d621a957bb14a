"""The page of the live loop, in a process of its own: a view in three dimensions, and controls."""
