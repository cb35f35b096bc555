"""A stretch of road: its ground, and the tracks of the lanes on it. Lines that were seen in several pictures are joined
into tracks beside the path, with smooth curves; centre lines lie between them. World frame, metres."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.polylines import lengths_along, resampled
from synth3dlanes.labels.labels import Direction, LaneKind, Marking, PaintColor
from synth3dlanes.recorded.drives.drive import Drive, DriveFrame, MarkedLane
from synth3dlanes.recorded.lift.cast import CastPoints, cast
from synth3dlanes.recorded.lift.cloud import WorldPoints, cloud_of, together
from synth3dlanes.recorded.lift.curves import GAP_M, STATION_STEP_M, SeenLine, smooth
from synth3dlanes.recorded.lift.ground import GroundMap, fit_ground
from synth3dlanes.recorded.lift.path import Path, path_of
from synth3dlanes.recorded.lift.precision import Precision
from synth3dlanes.system.arrays import Points2, Points3, Scalars
from synth3dlanes.system.errors import InputError

# Lines are followed pixel by pixel, but not closer than this on the image.
SAMPLE_PX = 3.0
# Places of a line are left out where the line of sight meets the ground at a smaller angle (its sine) than
# LEAST_GRAZING, or where the standard deviation along it exceeds the share MOST_SHIFT of the distance.
LEAST_GRAZING, MOST_SHIFT = 0.005, 0.25
# A line is left out if even its most certain places have a larger standard deviation: it could be any of several lines.
MAX_STD_M = 0.5
# Two lines are one if they share at least MIN_SHARED stations and are there within CLOSE_M or CLOSE_STD standard
# deviations of each other, but always nearer than the next line may be.
MIN_SHARED, CLOSE_M, CLOSE_STD, NEXT_M = 4, 0.4, 2.0, 1.7
# Two tracks are one lane if they share at least SAME_PLACES places, with a median distance below SAME_M.
SAME_M, SAME_PLACES = 0.8, 5
# A track shorter than this is noise.
MIN_LENGTH_M = 5.0
# A track is dropped if another is nearer than NARROWEST_M and its own sights are at most the share STRAY_SHARE of the
# other's.
STRAY_SHARE, NARROWEST_M = 0.5, 2.0


@dataclass(frozen=True, eq=False)
class Track:
    """A lane along the path: its stations, one metre apart but for gaps; its curve in the world; and how certain it is
    across and in height. `sights` is the number of the pictures' lines that it is made of: none for a lane that a
    person marked."""

    id: str
    s: Scalars
    d: Scalars
    xyz_world: Points3
    std_m: Float[np.ndarray, "n _"]
    sights: int = 1
    kind: LaneKind = "delimiter"
    marking: Marking = "solid"
    color: PaintColor | None = None
    direction: Direction = "same"
    left: str | None = None
    right: str | None = None
    is_marked: bool = False

    def has(self, s: float) -> bool:
        """Whether the track is known at a station."""
        return bool(len(self.s) and np.abs(self.s - s).min() <= STATION_STEP_M)

    def marked_as(self, lane: MarkedLane) -> "Track":
        """The track with what was said of its lane."""
        said = replace(self, kind=lane.kind, marking=lane.marking, color=lane.color, direction=lane.direction)
        return replace(said, sights=0, is_marked=True)

    def lies_at(self, plan: Points2) -> float:
        """Median distance of places (s, d) from the track, of those beside it; infinite if they cannot be of the same
        lane."""
        inside = (plan[:, 0] >= self.s[0]) & (plan[:, 0] <= self.s[-1])
        if inside.sum() < SAME_PLACES:
            return np.inf
        gap_m = float(np.median(np.abs(plan[inside, 1] - np.interp(plan[inside, 0], self.s, self.d))))
        return gap_m if gap_m < SAME_M else np.inf


@dataclass(eq=False)
class _Gathered:
    """The sights of a track that grows: at each station the sum of their weights, and the sum of their weighted
    offsets."""

    sights: list[SeenLine] = field(default_factory=list)
    sums: dict[int, Float[np.ndarray, "2"]] = field(default_factory=dict)

    def is_beside(self, sights: list[SeenLine]) -> bool:
        """Whether one picture shows the track and these sights as two lines beside each other."""
        spans: dict[int, list[tuple[float, float]]] = {}
        for sight in self.sights:
            spans.setdefault(sight.picture, []).append((float(sight.s.min()), float(sight.s.max())))
        return any(
            min(high, sight.s.max()) - max(low, sight.s.min()) > MIN_SHARED
            for sight in sights
            for low, high in spans.get(sight.picture, ())
        )

    def add(self, sights: list[SeenLine], sums: dict[int, Float[np.ndarray, "2"]]) -> None:
        self.sights += sights
        for station, value in sums.items():
            self.sums[station] = self.sums.get(station, np.zeros(2)) + value

    def apart(self, of: dict[int, Float[np.ndarray, "2"]]) -> float:
        """The median distance between a line and the track at common stations, as a share of the distance allowed;
        infinite with too few common stations. The more certain half of the stations counts more."""
        shared = [station for station in of if station in self.sums]
        if len(shared) < MIN_SHARED:
            return np.inf
        theirs, ours = (np.array([sums[station] for station in shared]) for sums in (of, self.sums))
        gap = np.abs(theirs[:, 1] / theirs[:, 0] - ours[:, 1] / ours[:, 0])
        std = np.sqrt(1 / theirs[:, 0] + 1 / ours[:, 0])
        share = gap / np.clip(CLOSE_STD * std, CLOSE_M, NEXT_M)
        # The nearer, more certain half decides.
        certain = std <= np.median(std)
        return float(max(np.median(share[certain]), 0.5 * np.median(share)))


def seen_lines(
    drive: Drive, frames: Iterable[DriveFrame], ground: GroundMap, path: Path, precision: Precision
) -> Iterator[SeenLine]:
    """The 2D lanes of frames, cast on the ground."""
    camera = drive.camera
    focal_px = float(np.sqrt(np.abs(np.linalg.det(camera.img_from_cam[np.ix_([0, 1], [0, 2])]))))
    for picture, frame in enumerate(frames):
        if not frame.lanes_px:
            continue
        world_from_cam = frame.world_from_host @ camera.host_from_cam
        lines = [_resampled(line, SAMPLE_PX) for line in frame.lanes_px]
        rays_cam = camera.lens.rays(camera.img_from_cam, np.concatenate(lines))
        rays_world = rays_cam @ world_from_cam[:3, :3].T
        found = cast(ground, world_from_cam[:3, 3], rays_world)
        ends = np.cumsum([len(line) for line in lines])[:-1]
        for part in np.split(np.arange(len(rays_world)), ends):
            places = CastPoints(*(values[part] for values in found))
            sight = _sight(places, world_from_cam[:3, 3], path, precision, focal_px)
            if sight is not None:
                yield sight._replace(picture=picture)


def marked_lines(
    marked: Sequence[MarkedLane], path: Path, precision: Precision
) -> Iterator[tuple[MarkedLane, SeenLine]]:
    """The lanes marked in the top view, beside the path."""
    for lane in marked:
        plan = path.to_plan(_resampled(lane.xy_world, STATION_STEP_M))
        own = np.full(len(plan), precision.marked_m)
        yield lane, SeenLine(plan[:, 0], plan[:, 1], plan, own, np.zeros((len(plan), 3)), picture=-1)


def joined(sights: Iterable[SeenLine]) -> list[list[SeenLine]]:
    """Sights of the same line, joined."""
    tracks: list[_Gathered] = []
    for sight in sights:
        _give(tracks, [sight], _stations(sight))
    # Pieces that later sights have brought together.
    kept: list[_Gathered] = []
    for track in sorted(tracks, key=lambda track: -sum(value[0] for value in track.sums.values())):
        _give(kept, track.sights, track.sums)
    return [track.sights for track in kept]


def _give(tracks: list[_Gathered], sights: list[SeenLine], sums: dict[int, Float[np.ndarray, "2"]]) -> None:
    """Add sights of one line to the track that they fit best, or as a track of their own."""
    fitting = sorted((track.apart(sums), i) for i, track in enumerate(tracks))
    for apart, i in fitting:
        if apart < 1 and not tracks[i].is_beside(sights):
            tracks[i].add(sights, sums)
            return
    tracks.append(_Gathered(list(sights), dict(sums)))


def curve_of(name: str, sights: Sequence[SeenLine], ground: GroundMap, path: Path) -> Track | None:
    """The smooth curve of a track on the ground; None where there is too little of it."""
    if np.median([sight.total_std.min() for sight in sights]) > MAX_STD_M:
        return None
    curve = smooth(list(sights))
    if curve is None or curve.supported.sum() * STATION_STEP_M < MIN_LENGTH_M:
        return None
    kept = curve.supported
    found = Track(name, curve.s[kept], curve.d[kept], unplaced(int(kept.sum())), curve.std[kept, None], len(sights))
    return on_ground(found, ground, path)


def unplaced(n: int) -> Points3:
    """The places in the world of a track's stations before they are on the ground."""
    return np.full((n, 3), np.nan)


def without_strays(tracks: Sequence[Track]) -> list[Track]:
    """The tracks, without tracks that run closer beside a track of many more sights than two lines can: they come from
    wrong poses or pixels."""
    kept: list[Track] = []
    for track in sorted(tracks, key=lambda track: -track.sights):
        if not any(_is_stray(track, other) for other in kept):
            kept.append(track)
    return kept


def _is_stray(track: Track, other: Track) -> bool:
    _, i, j = np.intersect1d(track.s, other.s, return_indices=True)
    if track.sights > STRAY_SHARE * other.sights or len(i) < len(track.s) / 2:
        return False
    gap = np.abs(track.d[i] - other.d[j])
    return bool(np.median(gap) < np.maximum(NARROWEST_M, 3 * np.median(np.hypot(track.std_m[i, 0], other.std_m[j, 0]))))


def on_ground(track: Track, ground: GroundMap, path: Path) -> Track | None:
    """The track with heights of the ground; stations without ground near them are left out."""
    xy = path.to_world(track.s, track.d)
    height, height_std = ground.at(xy)
    has = np.isfinite(height)
    if has.sum() * STATION_STEP_M < MIN_LENGTH_M:
        return None
    gap = np.abs(track.s[:, None] - track.s[has][None]).min(axis=1)
    kept = has | (gap <= GAP_M / 2)
    inside = (track.s >= track.s[has][0]) & (track.s <= track.s[has][-1])
    kept &= inside
    z = np.interp(track.s, track.s[has], height[has])
    z_std = np.interp(track.s, track.s[has], height_std[has]) + 0.01 * gap
    slopes = ground.slopes(xy)
    across = np.abs((np.nan_to_num(slopes) * path.right(track.s)).sum(axis=1))
    lateral = track.std_m[:, 0]
    return replace(
        track,
        s=track.s[kept],
        d=track.d[kept],
        xyz_world=np.column_stack([xy, z])[kept],
        std_m=np.column_stack([lateral, np.hypot(z_std, across * lateral)])[kept],
    )


def _sight(
    found: CastPoints, eye_world: Float[np.ndarray, "3"], path: Path, precision: Precision, focal_px: float
) -> SeenLine | None:
    """What one line of a picture says; None where its places are too few or too uncertain."""
    with np.errstate(invalid="ignore"):
        has = found.grazing > LEAST_GRAZING
    if has.sum() < 2:
        return None
    xyz, height_std, grazing = found.xyz_world[has], found.height_std_m[has], found.grazing[has]
    plan = path.to_plan(xyz[:, :2])
    to = xyz - eye_world
    far_m, level_m = np.linalg.norm(to, axis=1), np.linalg.norm(to[:, :2], axis=1)
    right = path.right(plan[:, 0])
    aside, ahead = (to[:, :2] * right).sum(axis=1), to[:, 1] * right[:, 0] - to[:, 0] * right[:, 1]
    off = np.hypot(precision.pose_at(far_m), far_m * precision.lanes_px / focal_px)
    shifts = np.column_stack([off, off / grazing, height_std / grazing]) / level_m[:, None]
    sight = SeenLine(plan[:, 0], plan[:, 1], np.column_stack([ahead, aside]), np.zeros(len(plan)), shifts)
    kept = shifts[:, 1] < MOST_SHIFT
    return sight.at(kept) if kept.sum() > 1 else None


def _stations(sight: SeenLine) -> dict[int, Float[np.ndarray, "2"]]:
    """A sight's weight and weighted offset at whole stations, one place for each."""
    at = np.round(sight.s).astype(int)
    low = at.min()
    count, variance = np.bincount(at - low), np.bincount(at - low, sight.total_std**2)
    offset = np.bincount(at - low, sight.d)
    return {int(low + i): np.array([1.0, offset[i] / count[i]]) * count[i] / variance[i] for i in np.flatnonzero(count)}


def _resampled(line: Float[np.ndarray, "n 2"], step: float) -> Float[np.ndarray, "m 2"]:
    """A polyline with a point at every step along it, and its ends."""
    return resampled(line, max(2, int(np.ceil(lengths_along(line)[-1] / step)) + 1))


# Widths between delimiters that bound a lane, along at least MIN_LANE_M without a gap: where lines meet or part they
# pass through these widths.
WIDTHS_M = (2.2, 5.0)
MIN_LANE_M = 10.0
# How the ids of delimiters begin that pictures show.
LINE = "line_"


def with_centres(tracks: Sequence[Track], ground: GroundMap, path: Path) -> list[Track]:
    """The tracks, and a centre line between each two delimiters that bound a lane and have none yet."""
    lines = [track for track in tracks if track.kind == "delimiter"]
    centres = []
    for left in lines:
        for right in lines:
            centre = _between(left, right, tracks)
            placed = None if centre is None else on_ground(centre, ground, path)
            if placed is not None:
                centres.append(placed)
    left_of = {centre.right: centre.id for centre in centres}
    right_of = {centre.left: centre.id for centre in centres}
    bounded = [replace(line, left=left_of.get(line.id), right=right_of.get(line.id)) for line in lines]
    others = [track for track in tracks if track.kind != "delimiter"]
    return [*bounded, *others, *centres]


def _between(left: Track, right: Track, tracks: Sequence[Track]) -> Track | None:
    """The centre line between two delimiters, where they bound a lane and no other track is between them."""
    shared, i, j = np.intersect1d(left.s, right.s, return_indices=True)
    width = right.d[j] - left.d[i]
    is_lane = (width > WIDTHS_M[0]) & (width < WIDTHS_M[1])
    if is_lane.sum() * STATION_STEP_M < MIN_LANE_M:
        return None
    middle = (left.d[i] + right.d[j]) / 2
    for other in tracks:
        if other.id not in (left.id, right.id):
            _, mine, theirs = np.intersect1d(shared, other.s, return_indices=True)
            inside = (other.d[theirs] > left.d[i][mine]) & (other.d[theirs] < right.d[j][mine])
            is_lane[mine[inside]] = False
    is_lane &= _in_long_runs(is_lane, shared)
    if not is_lane.any():
        return None
    std = np.hypot(left.std_m[i, 0], right.std_m[j, 0]) / 2
    return Track(
        id=f"centre_{left.id.removeprefix(LINE)}_{right.id.removeprefix(LINE)}",
        s=shared[is_lane],
        d=middle[is_lane],
        xyz_world=unplaced(int(is_lane.sum())),
        std_m=std[is_lane, None],
        kind="centerline",
        marking="none",
        color=None,
        direction=left.direction if left.direction == right.direction else "same",
        left=left.id,
        right=right.id,
    )


def _in_long_runs(is_lane: Bool[np.ndarray, " n"], stations: Scalars) -> Bool[np.ndarray, " n"]:
    """Which stations are in runs without a gap of at least MIN_LANE_M."""
    at = np.flatnonzero(is_lane)
    runs = np.split(at, np.flatnonzero(np.diff(stations[at]) > 1.5 * STATION_STEP_M) + 1)
    found = np.zeros(len(is_lane), dtype=bool)
    for run in runs:
        found[run] = len(run) * STATION_STEP_M >= MIN_LANE_M
    return found


# Scans from places closer than this tell nothing new; more points than this, of all scans, are thinned.
APART_M, MOST_POINTS = 0.5, 4_000_000


@dataclass(frozen=True, eq=False)
class Stretch:
    """The ground along a path, and the lanes on it: lanes that pictures show, then marked lanes."""

    path: Path
    ground: GroundMap
    tracks: tuple[Track, ...]


def lift_stretch(drive: Drive, frames: Sequence[DriveFrame], precision: Precision) -> Stretch:
    """The ground and the delimiters of some frames of a drive, from all of their scans and 2D lanes."""
    path = path_of([frame.world_from_host for frame in frames])
    ground = fit_ground(scans_along(drive, frames, path), path, precision)
    groups = joined(seen_lines(drive, frames, ground, path, precision))
    seen = [curve_of(f"line_{i}", group, ground, path) for i, group in enumerate(groups)]
    tracks = without_strays([track for track in seen if track is not None])
    for lane, sight in marked_lines(drive.marked, path, precision):
        track = curve_of(lane.id, [sight], ground, path)
        if track is not None:
            tracks.append(track.marked_as(lane))
    return Stretch(path, ground, tuple(tracks))


def scans_along(drive: Drive, frames: Sequence[DriveFrame], path: Path) -> WorldPoints:
    """The points of the frames' scans near their path, thinned. Raises InputError where there are none."""
    clouds: list[WorldPoints] = []
    last, every = None, 1
    for number, frame in enumerate(frames):
        place = frame.world_from_host[:2, 3]
        if last is not None and ((place - last) ** 2).sum() < APART_M**2:
            continue
        scan = frame.scan()
        if scan is not None:
            clouds.append(cloud_of(scan, drive.host_from_lidar, path, number).thinned(every))
            last = place
            # Scan by scan: the points of all of them may not fit into memory.
            while sum(len(cloud.scan) for cloud in clouds) > MOST_POINTS:
                clouds, every = [cloud.thinned(2) for cloud in clouds], 2 * every
    if not sum(len(cloud.scan) for cloud in clouds):
        raise InputError(f"{drive.name}: expected scans with points near the host's path, got none")
    return together(clouds)
