"""Anatomy: tissues, phantoms, and the distance to what must not be touched."""

    "mastoidectomy_path",
    "phantom_tissues",
