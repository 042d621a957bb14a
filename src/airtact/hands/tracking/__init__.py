"""Where the hand is now: frames of trackers, streams of them, recordings, and prediction."""
