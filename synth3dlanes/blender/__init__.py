"""The only package that imports bpy: Scene -> image. It reads geometry and computes no label but `object_visible`."""

import shutil

import bpy


def drop_scratch() -> None:
    """Remove Blender's temporary folder, which is not needed here. Blender itself removes it only on a clean exit."""
    shutil.rmtree(bpy.app.tempdir, ignore_errors=True)


drop_scratch()
