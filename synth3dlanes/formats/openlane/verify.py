"""The self-check of an OpenLane export."""

from collections.abc import Iterator
from pathlib import Path

from synth3dlanes.formats.line_score import Line3d
from synth3dlanes.formats.openlane.convention import ground_from_waymo
from synth3dlanes.formats.openlane.read import OpenLaneFrame, parse
from synth3dlanes.formats.openlane.score import prune, score
from synth3dlanes.formats.openlane.write import CASES
from synth3dlanes.formats.reading import listed_files, read_text
from synth3dlanes.formats.self_check import Benchmark3d, Verification, image_problems, verify_3d

BENCHMARK = Benchmark3d(score, prune, missing_m=0.0)
CASE_OF_LIST = {name: case for case, name in CASES.items()}


def verify(out: Path, size_px: tuple[int, int], most_frames: int) -> Iterator[Verification]:
    """The lines of every list."""
    for path in sorted([*(out / "lists").glob("*.txt"), *(out / "lane3d_1000/test").glob("*.txt")]):
        case = CASE_OF_LIST.get(path.name)
        images = listed_files(path, most_frames)
        if not images:
            continue
        labels = [image.replace("jpg", "json") for image in images]
        if case is not None:
            labels = [f"test/{case}_case/{label.partition('/')[2]}" for label in labels]
        files = [out / "lane3d_1000" / label for label in labels]
        frames = [parse(read_text(file), str(file)) for file in files]
        problems = image_problems([out / "images" / image for image in images], size_px)
        problems += [
            f"{image}: file_path is {frame.file_path}"
            for image, frame in zip(images, frames, strict=True)
            if frame.file_path != image
        ]
        true = [_lines(frame) for frame in frames]
        yield verify_3d(str(path.relative_to(out)), true, problems, BENCHMARK)


def _lines(frame: OpenLaneFrame) -> list[Line3d]:
    vehicle_from_cam = frame.vehicle_from_cam_waymo
    return [
        Line3d(ground_from_waymo(line.xyz_waymo, vehicle_from_cam), line.visible, line.category) for line in frame.lines
    ]
