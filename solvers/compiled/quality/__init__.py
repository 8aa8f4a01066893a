"""How far contacts reach, and the search of shares that cover directions."""
