"""Published experiments, done again from the paper's own numbers: their figures, and what comes out."""
