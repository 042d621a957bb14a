"""Scripts that other packages' own interpreters run: one case in, one transfer matrix and its times out."""
