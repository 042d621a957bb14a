"""How quick airtact is, and how quick others are: scenes, truths, times."""
