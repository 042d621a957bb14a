"""Into the world: the messages of boards, the links that carry them, and stopping safely."""
