"""Virtual bone-burring experiments: forces, erosion, descents and fits of c_e and alpha."""

import burrlab.starting  # noqa: F401  # isort: skip  # before all others
from burrlab.common.face import face

__getattr__, __dir__, __all__ = face(__name__, __file__)
