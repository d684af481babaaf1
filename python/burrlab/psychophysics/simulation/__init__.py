"""Hands that probe and drill, what they feel, and subjects made of noise and a rule."""
