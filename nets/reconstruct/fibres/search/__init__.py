"""Which lines there are: where they begin, and the moves that a descent cannot make."""
