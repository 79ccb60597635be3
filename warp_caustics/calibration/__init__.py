"""Finding the bench from captures of plates that are known: values, how sure they are, and what would tell more."""
