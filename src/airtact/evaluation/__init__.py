"""How good it is: fields and figures of a drive, by a solver that did not make it."""
