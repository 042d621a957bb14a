"""The page of the live loop, in a process of its own: what the loop does, in three dimensions, and its controls."""
