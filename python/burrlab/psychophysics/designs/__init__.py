"""Designs of experiments and the orders of their trials; thresholds from levels and answers."""
