"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.group_d_prime import GroupDPrime, group_d_prime

__all__ = ["GroupDPrime", "group_d_prime"]
