"""Models, textures and skies: those of the project, and a user's own in their place. No Blender."""
