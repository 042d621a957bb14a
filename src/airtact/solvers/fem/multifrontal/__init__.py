"""A multifrontal direct factorisation of sparse complex symmetric matrices."""
