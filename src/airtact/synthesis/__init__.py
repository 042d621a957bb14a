"""What to emit: a transfer matrix and a target in, a drive out."""
