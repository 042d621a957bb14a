"""A damaged triangle mesh made closed, step by step."""
