"""The fit of c_e and alpha, and what the data say about them."""
