"""Read an OpenLane-V2 export back and compare it with our labels."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.comparing import Comparison, Rule, SourceSample, compare_map
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.openlane_v2.convention import AHEAD_M, ASIDE_M, ROOT
from synth3dlanes.formats.openlane_v2.read import TopologyFrame, frames, parse
from synth3dlanes.formats.reading import image_size, read_text
from synth3dlanes.frames import transform
from synth3dlanes.geometry.map_roads import map_network
from synth3dlanes.scene import Scene

# A curve that is sampled every metre and one that is sampled every half are some millimetres apart.
RULE = Rule("m", 0.05, name="lane", slack=0.3)
GAP_M = 1e-3
SIDE_M = 0.05
# What is this near to the area's border may be out of it.
BORDER_M = 2.0


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """The frames of every part: their centre lines, then their lane segments."""
    for part, paths in frames(out).items():
        for name, suffix in ((part, ""), (f"{part}, lane segments", "-ls")):
            files = (path.with_name(f"{path.stem}{suffix}.json") for path in paths[:most_frames])
            yield FrameList(name, _frames(out, files))


def _frames(out: Path, files: Iterator[Path]) -> Iterator[ReadFrame]:
    for path in files:
        frame = parse(read_text(path), str(path))
        image, *others = frame.images.values()
        problems = tuple(_image_problems(out, others))
        yield ReadFrame(str(path.relative_to(out)), str(path), f"{ROOT}/{image}", (frame, problems))


def _image_problems(out: Path, images: list[str]) -> Iterator[str]:
    for image in images:
        try:
            image_size(out / ROOT / image)
        except FormatError as error:
            yield f"expected the image {image}: {error}"


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lanes in metres, in the world frame; boundaries by their side and distance; what follows what."""
    found, problems = frame.content
    graph = truth.labels.graph
    if any(not 0 <= i < len(graph.segments) for i in found.ids) or len({*found.ids}) < len(found.ids):
        text = f"expected ids of their own below {len(graph.segments)}, got {list(found.ids)}"
        return Comparison(len(found.ids), (), (*problems, text))
    names = [graph.segments[i].id for i in found.ids]
    lanes = [
        (name, transform(found.world_from_ego, lines[0])) for name, lines in zip(names, found.lanes_ego, strict=True)
    ]

    def is_in_area(points_world: Float[np.ndarray, "n 3"]) -> np.ndarray:
        x, y, _ = ((points_world - found.world_from_ego[:3, 3]) @ found.world_from_ego[:3, :3]).T
        return np.asarray((x < AHEAD_M - BORDER_M) & (np.abs(y) < ASIDE_M - BORDER_M))

    compared = compare_map(lanes, truth, RULE, is_in_area)
    sides = _side_problems(found, names, _half_widths(truth.scene, names))
    return compared.because([*problems, *sides, *_topology_problems(found, names, graph.successors)])


def _half_widths(scene: Scene, names: list[str]) -> list[tuple[float, float]]:
    """Half the least and the greatest width of each lane."""
    if scene.map is None:
        half_m = scene.paper_road.lane_width_m / 2
        return [(half_m, half_m)] * len(names)
    found = []
    network = map_network(scene.map, scene.terrain, scene.camera.y_m)
    for name in names:
        lane = network.lanes[name]
        left, right = network.road(lane.road).edges_of(lane)
        s = np.linspace(lane.start_m, lane.end_m, 50)
        widths_m = right(s) - left(s)
        found.append((float(widths_m.min()) / 2, float(widths_m.max()) / 2))
    return found


def _side_problems(found: TopologyFrame, names: list[str], halves_m: list[tuple[float, float]]) -> Iterator[str]:
    """Findings where a boundary is on the other side of its lane, or not half a lane's width from its middle, seen from
    above."""
    for name, lines, (least_m, most_m) in zip(names, found.lanes_ego, halves_m, strict=True):
        middle, *sides = (transform(found.world_from_ego, line)[:, :2] for line in lines)
        along = np.gradient(middle, axis=0)
        for side, sign, line in zip(("left", "right"), (1, -1), sides, strict=False):
            (x, y), (dx, dy) = (line - middle).T, along.T
            got_m = float(np.median(sign * (dx * y - dy * x) / np.maximum(np.hypot(dx, dy), 1e-9)))
            if not least_m - SIDE_M <= got_m <= most_m + SIDE_M:
                yield f"lane {name}: expected its {side} boundary {most_m:.3f} m on that side, got {got_m:.3f} m"


def _topology_problems(found: TopologyFrame, names: list[str], successors: dict[str, tuple[str, ...]]) -> Iterator[str]:
    for i, lane in enumerate(names):
        for j, other in enumerate(names):
            gap_m = float(np.linalg.norm(found.lanes_ego[i][0][-1] - found.lanes_ego[j][0][0]))
            follows = other in successors.get(lane, ())
            if found.follows[i, j] and not (follows and gap_m <= GAP_M):
                yield f"lane {other}: expected it not to follow {lane}, got it {gap_m:.3f} m from its end"
            if not found.follows[i, j] and follows and gap_m <= GAP_M:
                yield f"lane {other}: expected it to follow {lane}, whose end it touches, got it not to"
