"""Save a picture of each sample that fails in the folder `validation` of the data set."""

import io
from contextlib import suppress
from pathlib import Path, PurePath

import numpy as np
from fsspec.implementations.local import LocalFileSystem
from jaxtyping import UInt8
from PIL import Image

from synth3dlanes.dataset.address import connect, translate_store_errors
from synth3dlanes.errors import FormatError, OutageError
from synth3dlanes.figures.overlay import draw_overlay, stretches_img
from synth3dlanes.files import Folder
from synth3dlanes.labels import Labels

FOLDER = "validation"
# No lanes are drawn if a line extends farther than this outside the image.
MAX_PX = 1e5

Picture = UInt8[np.ndarray, "h w 3"]


def draw(image: Picture, labels: Labels) -> Picture:
    """The image with its lanes, if these can be drawn."""
    lines_img = [line for lane in labels.lanes for _, line in stretches_img(labels.camera, lane)]
    return draw_overlay(image, labels) if all((np.abs(line) < MAX_PX).all() for line in lines_img) else image


def save_picture(place: str, name: str, picture: Picture) -> None:
    """Write a picture into the data set; does nothing if the store or the folder cannot be written."""
    files, root = connect(place)
    stream, path = io.BytesIO(), f"{FOLDER}/{name}.png"
    Image.fromarray(picture).save(stream, "PNG")
    with suppress(FormatError, OutageError, OSError), translate_store_errors(place):
        if isinstance(files, LocalFileSystem):
            Folder(Path(root)).make(PurePath(path).parent)
            Folder(Path(root)).write(path, stream.getvalue())
        else:
            files.pipe_file(f"{root}/{path}", stream.getvalue())


def remove_pictures(place: str) -> None:
    """Remove the pictures of an earlier validation."""
    files, root = connect(place)
    if isinstance(files, LocalFileSystem):
        with suppress(OSError):
            folder = Folder(Path(root))
            for name in folder.names(FOLDER):
                if name.endswith(".png"):
                    folder.remove(f"{FOLDER}/{name}")
        return
    with suppress(FormatError, OutageError), translate_store_errors(place):
        for path in files.find(f"{root}/{FOLDER}", maxdepth=1):
            if str(path).endswith(".png"):
                files.rm_file(path)
