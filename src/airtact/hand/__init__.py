"""A hand from its joints: its shape, its skin, how it moves."""
