"""Measured data: curves, indentations and depth traces; synthetic ones too."""
