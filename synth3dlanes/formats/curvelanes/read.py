"""Read CurveLanes: the lines of a frame. Pixels."""

import numpy as np
from jaxtyping import Float

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.reading import MALFORMED, json_object


def parse(text: str, where: str) -> tuple[Float[np.ndarray, "_ 2"], ...]:
    """A file `.lines.json`; FormatErrors begin with `where`."""
    document = json_object(text, where)
    try:
        return tuple(
            np.array([(point["x"], point["y"]) for point in line], dtype=float).reshape(-1, 2)
            for line in document["Lines"]
        )
    except MALFORMED as error:
        raise FormatError(f"{where}: not lines of CurveLanes: {type(error).__name__}: {error}") from None


def labels_path(image: str) -> str:
    """Where the lines of an image are, `images/a.jpg` or `train/images/a.jpg`."""
    folder, _, name = image.rpartition("images/")
    return f"{folder}labels/{name.removesuffix('.jpg')}.lines.json"
