"""Models, textures and skies: the built-in ones, and a user's own in their place. No Blender."""
