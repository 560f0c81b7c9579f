"""How bytes arrive: one kind of source per file, and the table of them."""
