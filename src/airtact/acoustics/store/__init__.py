"""Solved shapes kept in memory and on disk, found again by all that determines them."""
