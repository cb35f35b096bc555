"""Uncompressed copies of textures for worker processes: Cycles reads every file again for every render.

Decoding JPEG costs 2 % of an image at the default settings. Packing a file into Blender costs more than it saves.
"""

import hashlib
import os
from contextlib import suppress
from functools import partial
from pathlib import Path

from PIL import Image

from synth3dlanes.scene.settings import SCRATCH
from synth3dlanes.system.files import Folder, encoded


def quick_copy(file: Path) -> Path:
    """An uncompressed copy of a JPEG in the scratch folder that a run's workers share, created on first use. Returns
    the file itself if there is no such folder or the copy fails."""
    scratch = os.environ.get(SCRATCH)
    if scratch is None or file.suffix.lower() not in (".jpg", ".jpeg"):
        return file
    copy = Path(scratch) / f"{file.stem}-{hashlib.sha256(str(file).encode()).hexdigest()[:16]}.tif"
    if not copy.exists():
        with suppress(OSError), Image.open(file) as picture:
            Folder(copy.parent).write(copy.name, encoded(partial(picture.save, format="TIFF")))
    return copy if copy.exists() else file
