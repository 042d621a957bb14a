"""Bodies factorised one by one: their reduction, how they scatter each other's field, and their field."""
