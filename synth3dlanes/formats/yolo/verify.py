"""The self-check of a YOLO export: outlines of known classes, inside their images and around some pixels."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from synth3dlanes.formats.reading import image_size, listed_files, numbers, read_text
from synth3dlanes.formats.self_check import Verification
from synth3dlanes.formats.writing import PARTS
from synth3dlanes.formats.yolo.write import LEAST_PX, NAMES


def verify(out: Path, most_frames: int) -> Iterator[Verification]:
    """The frames of every part."""
    for part in PARTS:
        path = out / f"{part}.txt"
        if not path.exists():
            continue
        images = listed_files(path, most_frames)
        problems, n_objects = list[str](), 0
        for image in images:
            width_px, height_px = image_size(out / image)
            where = out / "labels" / f"{Path(image).stem}.txt"
            for text in read_text(where).splitlines():
                number, _, shares = text.partition(" ")
                corners = numbers(shares, str(where))
                n_objects += 1
                is_known = number.isdecimal() and len(number) < 4 and int(number) < len(NAMES)
                if not is_known or not len(corners) or corners.min() < 0 or corners.max() > 1:
                    problems.append(
                        f"{where}: expected a class below {len(NAMES)} and shares of the image, got {text:.60}"
                    )
                elif _area_px(corners * [width_px, height_px]) < LEAST_PX - 0.5:
                    problems.append(f"{where}: expected outlines of {LEAST_PX} pixels and more, got {text:.60}")
        yield Verification(part, len(images), n_objects, {}, {}, tuple(problems))


def _area_px(corners: np.ndarray) -> float:
    x, y = corners.T
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)
