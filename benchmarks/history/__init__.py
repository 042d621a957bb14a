"""Benchmarks of our own history, for airspeed velocity: `asv run main~10..main`, then `asv publish`."""
