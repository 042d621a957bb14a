"""The scene file: a TOML text that says what is in the air, who speaks and what shall be felt."""
