"""Virtual bone-burring experiments: forces, erosion, descents and fits of c_e and alpha."""
from burrlab._core import *
