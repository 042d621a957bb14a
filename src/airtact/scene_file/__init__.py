"""The scene file: a TOML text that describes the bodies, the transducers, and what a person is to feel."""
