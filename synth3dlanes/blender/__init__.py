"""The only package that imports bpy: Scene -> image. It reads geometry and computes no label but `object_visible`."""
