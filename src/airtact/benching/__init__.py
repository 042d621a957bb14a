"""The bench: times of airtact and of other packages on scenes with a reference, each with its error."""
