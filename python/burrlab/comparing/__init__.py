"""Fits beside one another: data sets of one material or not, and laws of erosion."""
