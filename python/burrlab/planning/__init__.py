"""What to measure next, how many specimens and runs a comparison needs, and how often intervals hold the truth."""
