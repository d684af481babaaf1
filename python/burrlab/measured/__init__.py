"""What was measured: curves, indentations, depth traces; and synthetic ones."""
