"""Bone: materials, specimens, volumes and their files, tissues, half-drilled states."""
