"""The page of the live loop, served by its own process: a 3-D view and controls."""
