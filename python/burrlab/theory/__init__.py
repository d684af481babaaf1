"""Theory without voxels: closed forms and the mean field."""
