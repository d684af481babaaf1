"""Recordings of other programs: volumetric_drilling, and logs of VRPN."""
