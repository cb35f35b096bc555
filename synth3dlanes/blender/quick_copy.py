"""Copies of textures that Cycles reads quickest: it reads every file anew for every render. Workers alone have them.

Decoding JPEG costs 2 % of an image at the default settings. Packing a file into Blender costs more than it saves.
"""

import hashlib
import os
import tempfile
from contextlib import suppress
from pathlib import Path

from PIL import Image

from synth3dlanes.settings import SCRATCH


def quick_copy(file: Path) -> Path:
    """An uncompressed copy of a JPEG in the folder that the workers of a run share, made by the first to ask; the file
    itself where there is no such folder or no room in it."""
    scratch = os.environ.get(SCRATCH)
    if scratch is None or file.suffix.lower() not in (".jpg", ".jpeg"):
        return file
    copy = Path(scratch) / f"{file.stem}-{hashlib.sha256(str(file).encode()).hexdigest()[:16]}.tif"
    if not copy.exists():
        with suppress(OSError), Image.open(file) as picture, tempfile.TemporaryDirectory(dir=scratch) as folder:
            picture.save(Path(folder) / copy.name)
            os.replace(Path(folder) / copy.name, copy)
    return copy if copy.exists() else file
