"""Independent methods that solvers are held to: nothing in src may import them."""
