"""Closed forms and the mean field: what follows from the equations without a voxel."""
