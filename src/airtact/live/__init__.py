"""The sound follows a moving hand: frames of a tracker become drives at the boards, and what was done is recorded."""
