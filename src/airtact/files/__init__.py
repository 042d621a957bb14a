"""Reading and writing files: whole ones or none, and tables of text."""
