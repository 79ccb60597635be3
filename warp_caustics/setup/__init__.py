"""The set-up as named numbers: what an image's derivatives by them are, and which of them an image fixes."""
