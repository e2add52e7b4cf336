"""Body parts of every pixel, by two networks in a row: who is a person, and which part of them."""
