"""Separately factorised bodies: their reduction, their coupling and their field."""
