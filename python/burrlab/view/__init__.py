"""What the surgeon sees: surface, scene, pictures, film, page. Nothing here is imported before it is used."""
