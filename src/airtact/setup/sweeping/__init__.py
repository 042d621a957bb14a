"""A function at many points, on many processors: what is done is kept, what fails is a row with its sentence."""
