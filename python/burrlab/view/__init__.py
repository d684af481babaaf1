"""The surgeon's view: surface, scene, pictures, film, page. pyvista is imported only where it is used."""

from burrlab.common.face import face

__getattr__, __dir__, __all__ = face(__name__, __file__)
