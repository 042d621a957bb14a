"""The finite element method (FEM) with NGSolve, for sound-hard, impedance and filled bodies."""
