"""The world's geometry in numpy: terrain, road, lanes, visibility and meshes. No Blender, no files."""
