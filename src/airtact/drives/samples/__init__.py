"""Drives for many sampled transfer matrices at once, and what no drive exceeds over them."""
