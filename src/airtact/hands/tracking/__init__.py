"""Hand tracking: frames, streams, recordings and prediction."""
