"""Drives that know the hand: what solves it beside the loop, what is kept of that, and what is made of it."""
