"""The signed values of one sample for the tests over the whole data set (`bias.TESTS`): paint, surface and hills."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import Ramp
from synth3dlanes.roads.terrain import gradient_at, height_at
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.arrays import Passes, Points3, Scalars
from synth3dlanes.validate.centroids import PaintOffset, image_offsets, line_views, paint_offsets
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Signed
from synth3dlanes.validate.places import places
from synth3dlanes.world.world import World

# Least amount of paint for a value: pixels, or slices of an image.
MIN_WEIGHT = {"paint": 30.0, "image": 15.0, "exit": 30.0}
# Lines this close to the camera's vertical plane count as on neither side.
ASIDE_M = 0.5
# The opening of a road is measured from this far after its begin on.
MIN_OPENING_M = 5.0
# Range for the surface's height, range for errors that grow with distance, and least number of points.
NEAR_M, FAR_M, MIN_POINTS = 25.0, 110.0, 10
# A pixel whose depth differs from its point's by more than this share shows another object.
OTHER = 0.2
# Least root mean square of a cause's displacement, which for `relief` is the hills' height; least number of points this
# high on a ramp; and least length of a ramp: the faces of far rows cut the corners of shorter ones.
MIN_HEIGHT_M, MIN_RAMP_POINTS, MIN_RAMP_M = 0.3, 3, 8.0
RAMP_SHARES = np.linspace(-0.2, 0.2, 81)
# Causes are separated only up to this condition number of the fit. Points farther off than OUTLIER times the median
# error, and than OUTLIER_M, get less weight.
MAX_CONDITION, ROUNDS, OUTLIER, OUTLIER_M = 200.0, 4, 3.0, 0.003
# Excludes paint, which floats over the road.
PAVEMENT = [SEMANTIC_IDS[name] for name in ("road", "shoulder")]


def signed_values(evidence: Evidence) -> Iterator[Signed]:
    """All signed values of this sample that its passes allow, of a clip those of its first frame: its frames are alike,
    and the tests over the data set take samples as independent."""
    if evidence.scene.shot.frame:
        return
    network, labels, passes = evidence.world.network, evidence.labels, evidence.passes
    views = line_views(evidence.paint, labels)
    if "instance" in passes:
        lines = list(paint_offsets(views, passes["instance"]))
        yield from _sides("paint", lines)
        if any(road.parting for road in network.roads):
            yield from _opening(network, labels, [line for line in lines if line.lane.road != network.main.id])
    if evidence.paint.shows:
        yield from _sides("image", list(image_offsets(views, evidence.luma)))
    if "depth" in passes:
        yield from _surface(evidence.world, labels, passes)


def _sides(name: str, lines: Sequence[PaintOffset]) -> Iterator[Signed]:
    """Offsets of paint to the right, and outward, away from the camera's vertical plane."""
    points_cam, n_px, moment_m = _joined(lines)
    side = np.sign(points_cam[:, 0]) * (np.abs(points_cam[:, 0]) > ASIDE_M)
    for which, sign in (("right", np.ones(len(side))), ("outward", side)):
        weight = float(n_px @ np.abs(sign))
        if weight >= MIN_WEIGHT[name]:
            yield Signed(f"{name}_{which}_m", float(moment_m @ sign) / weight)


def _opening(network: Network, labels: Labels, lines: Sequence[PaintOffset]) -> Iterator[Signed]:
    """Increase of the offset of a parting road's paint away from the main road per metre from where it begins."""
    points_cam, n_px, moment_m = _joined([_as_driven(labels, line) for line in lines])
    s_m, _ = network.main.line.project(transform(labels.camera.world_from_cam, points_cam)[:, :2])
    s_m = np.where(s_m > MIN_OPENING_M, s_m, 0.0)
    if n_px @ np.sign(s_m) >= MIN_WEIGHT["exit"]:
        yield Signed("exit_opening", float(network.rightward * (s_m @ moment_m) / (n_px @ s_m**2)))


def _as_driven(labels: Labels, line: PaintOffset) -> PaintOffset:
    """An offset to the right as the host drives."""
    way_cam = line.lane.xyz_cam[-1] - line.lane.xyz_cam[0]
    return line._replace(moment_m=np.sign(labels.camera.road_from_cam[1, :3] @ way_cam) * line.moment_m)


def _surface(world: World, labels: Labels, passes: Passes) -> Iterator[Signed]:
    """Height of the rendered road above its labels, and the relative errors of focal length, depth, hills and ramp
    that would explain it."""
    network = world.network
    points_cam, points_world = _seen(network, labels, passes)
    s_m, branch = network.main.line.project(points_world[:, :2])[0], network.roads[-1]
    if branch.parting is not None:
        s_m = branch.line.project(points_world[:, :2], np.maximum(s_m, branch.start_m))[0]
    raised_m = places(world.ground, points_world[:, :2]).raised()
    slope = gradient_at(network.terrain, points_world[:, :2])
    up_world = np.column_stack([-slope, np.ones(len(slope))])
    up_world /= np.linalg.norm(up_world, axis=1, keepdims=True)
    up_cam, upright = up_world @ labels.camera.world_from_cam[:3, :3], up_world[:, 2]
    above_m = (points_world[:, 2] - height_at(network.terrain, points_world[:, :2]) - raised_m) * upright
    level, near = raised_m == 0, points_cam[:, 1] < NEAR_M
    if (level & near).sum() >= MIN_POINTS:
        yield Signed("surface_above_m", float(np.median(above_m[level & near])))
    if level.sum() >= MIN_POINTS:
        causes = {
            "focal_length": (up_cam * points_cam * [1, 0, 1]).sum(axis=1),
            "depth_scale": (up_cam * points_cam).sum(axis=1),
            "relief": transform(labels.camera.road_from_cam, points_cam)[:, 2] * upright,
        }
        yield from _shares({name: moved_m[level] for name, moved_m in causes.items()}, above_m[level])
    ramp = branch.ramp
    if ramp and ramp.length_m > MIN_RAMP_M and (raised_m > MIN_HEIGHT_M).sum() >= MIN_RAMP_POINTS:
        yield Signed("ramp", _ramp_share(ramp, s_m[~level], (raised_m + above_m / upright)[~level]))


def _shares(causes: Mapping[str, Scalars], above_m: Scalars) -> Iterator[Signed]:
    """The shares of all causes that together explain the points' heights above the labels, by least squares with less
    weight for outliers. Nothing if causes are indistinguishable, as focal length and depth are on a flat road."""
    found = {name: moved_m for name, moved_m in causes.items() if _size(moved_m) > MIN_HEIGHT_M}
    if not found:
        return
    a = np.column_stack(list(found.values()))
    if np.linalg.cond(a / np.linalg.norm(a, axis=0)) > MAX_CONDITION:
        return
    weight = np.ones(len(above_m))
    for _ in range(ROUNDS):
        shares = np.linalg.lstsq(a * weight[:, None], above_m * weight, rcond=None)[0]
        off = np.abs(above_m - a @ shares)
        weight = 1 / np.sqrt(np.maximum(1, off / max(OUTLIER * float(np.median(off)), OUTLIER_M)))
    for name, share in zip(found, shares, strict=True):
        yield Signed(name, float(share))


def _seen(network: Network, labels: Labels, passes: Passes) -> tuple[Points3, Points3]:
    """The surface points that pixels show at visible label points, in camera and world frame. Delimiters are used on
    other roads than the host's only: paint and road cannot be distinguished without semantic ids."""
    camera = labels.camera
    lanes = [lane for lane in labels.lanes if lane.kind == "centerline" or lane.road != network.main.id]
    seen = [lane.visible & (lane.xyz_cam[:, 1] > 0) & (lane.xyz_cam[:, 1] < FAR_M) for lane in lanes]
    labelled_cam = np.concatenate([lane.xyz_cam[at] for lane, at in zip(lanes, seen, strict=True)])
    last = [camera.width_px - 1, camera.height_px - 1]
    column, row = np.clip(np.floor(camera.project(labelled_cam)), 0, last).astype(int).T
    depth_m = passes["depth"][row, column].astype(float)
    same = np.abs(depth_m / labelled_cam[:, 1] - 1) < OTHER
    if "semantic" in passes:
        same &= np.isin(passes["semantic"][row, column], PAVEMENT)
    points_cam = camera.points(np.column_stack([column, row])[same] + 0.5, depth_m[same])
    return points_cam, transform(camera.world_from_cam, points_cam)


def _ramp_share(ramp: Ramp, s_m: Scalars, height_m: Scalars) -> float:
    """Relative height difference between the scene's ramp and the one that fits the heights over the terrain best. A
    higher ramp is also longer, so it is lower near its start."""
    higher = [Ramp(ramp.start_m, (1 + share) * ramp.length_m, (1 + share) * ramp.height_m) for share in RAMP_SHARES]
    return float(RAMP_SHARES[np.argmin([np.abs(height_m - other(s_m)).sum() for other in higher])])


def _joined(lines: Sequence[PaintOffset]) -> tuple[Points3, Scalars, Scalars]:
    """The slices of all lines: points, pixel counts, moments."""
    points_cam = np.concatenate([np.zeros((0, 3)), *(line.points_cam for line in lines)])
    n_px, moment_m = (np.concatenate([np.zeros(0), *(line[i] for line in lines)]) for i in (2, 3))
    return points_cam, n_px, moment_m


def _size(values: Scalars) -> float:
    """The root mean square; 0 for no values."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
