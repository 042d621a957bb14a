"""The finite element method (FEM) on NGSolve, for sound-hard, impedance and filled bodies."""
