"""Computation of drives that account for the hand, and the processes that solve its scattering."""
