"""Samples of hands, air and transducers that are in doubt, and the transfer matrix of each."""
