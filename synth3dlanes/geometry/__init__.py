"""The world as pure numpy: frames, terrain, road, lanes, visibility and meshes. No Blender, no files."""
