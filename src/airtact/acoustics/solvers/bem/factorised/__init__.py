"""Bodies factorised one by one: their reduction, their coupling and their field."""
