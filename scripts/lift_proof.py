"""How far lifted lanes are from the truth: `python -m scripts.lift_proof FOLDER --clips 10` makes clips with lidars in
FOLDER, lifts each as a drive, exact and with noise, and writes the tables of docs/lift.md.

Clips that are there are kept. A clip takes half a minute to make on one core, and some ten seconds to lift each time.
"""

import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from scripts.lift_noise import Noise, enlarged, worsened
from scripts.lift_score import LiftErrors, errors_of, together
from synth3dlanes.api import generate_dataset, load_params
from synth3dlanes.dataset.read import Reader
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels
from synth3dlanes.recorded.drives.drive import Drive, MarkedLane
from synth3dlanes.recorded.drives.open import read_clip
from synth3dlanes.recorded.lift.precision import NO_ERROR, Precision
from synth3dlanes.recorded.lift.run import lifted_frames
from synth3dlanes.system.processes import process_pool

PAGE = Path(__file__).parents[1] / "docs/lift.md"
PRESETS, LIDARS = ("streets", "realistic"), ("hdl_32e", "hdl_64e")
FRAMES, FPS, SEED = 24, 5.0, 45
# Small pictures are rendered in no time; 2D lines are those of a camera as many pixels wide as this.
CHANGES = ("camera.width_px=120", "camera.height_px=80", "motion.host_speed_m_s=[10,20]")
WIDTH_PX = 1280
BANDS_M = ((0, 20), (20, 40), (40, 60), (60, 80), (80, 110))


class Case(NamedTuple):
    """A case of the table: its name, what is wrong, how exact the drive is said to be, and whether its lanes are marked
    in the top view instead of its images."""

    name: str
    noise: Noise
    precision: Precision
    marked: bool = False


CASES = (
    Case("exact", Noise(), NO_ERROR),
    Case("exact, marked in the top view", Noise(), NO_ERROR, marked=True),
    Case("poses 2 cm, 0.1°", Noise(pose_m=0.02, pose_deg=0.1), replace(NO_ERROR, pose_m=0.02, pose_deg=0.1)),
    Case(
        "calibration 2 cm, 0.1°",
        Noise(calibration_m=0.02, calibration_deg=0.1),
        replace(NO_ERROR, calibration_m=0.02, calibration_deg=0.1),
    ),
    Case("2D lanes 2 px", Noise(lanes_px=2.0), replace(NO_ERROR, lanes_px=2.0)),
    Case("half the beams", Noise(every_other_beam=True), NO_ERROR),
    Case("rain", Noise(lost=0.5, spray=0.02, range_m=0.02), replace(NO_ERROR, pose_m=0.005)),
)


@dataclass(frozen=True)
class Job:
    """A clip to be lifted in a case: the split, the number of its scene, the case, and the seed of its noise."""

    url: str
    scene: int
    case: Case
    seed: int


def make(folder: Path, clips: int) -> list[str]:
    """The splits of clips, made where they are missing."""
    urls = []
    for preset in PRESETS:
        for lidar in LIDARS:
            out = folder / f"{preset}_{lidar}"
            params = load_params(preset, CHANGES)
            generate_dataset(
                params, out, n=clips * FRAMES, seed=SEED, frames=FRAMES, fps=FPS, samples=1, lidar=lidar, workers=1,
                device="cpu",
            )  # fmt: skip
            urls.append(f"{out}/train")
    return urls


def lift(job: Job) -> tuple[Job, LiftErrors, float]:
    """The errors of one clip, and the seconds of this process that lifting took."""
    reader = Reader(job.url)
    truth = [reader.labels(i) for i in reader.clip(job.scene, 0)]
    drive = worsened(enlarged(read_clip(reader, job.scene), WIDTH_PX), job.case.noise, job.seed)
    if job.case.marked:
        drive = marked(drive, truth)
    start = time.process_time()
    labels = [found.labels for found in lifted_frames(drive, job.case.precision)]
    return job, errors_of(labels, truth), time.process_time() - start


def marked(drive: Drive, truth: Sequence[Labels]) -> Drive:
    """The drive without 2D lanes, but with every delimiter that a frame shows, marked in the top view."""
    found: dict[str, list[np.ndarray]] = {}
    for labels in truth:
        for lane in labels.lanes:
            if lane.kind == "delimiter":
                found.setdefault(lane.id, []).append(transform(labels.camera.world_from_cam, lane.xyz_cam)[:, :2])
    onwards = np.sign(drive.frames[-1].world_from_host[1, 3] - drive.frames[0].world_from_host[1, 3])
    lines = []
    for name, parts in found.items():
        xy = np.concatenate(parts)
        lines.append(MarkedLane(name, xy[np.argsort(onwards * xy[:, 1])]))
    frames = [replace(frame, lanes_px=()) for frame in drive.frames]
    return replace(drive, frames=frames, marked=tuple(lines))


def rows(errors: LiftErrors) -> Iterator[str]:
    """The cells of each band: median and 95 % across and in height in centimetres, the shares of points within one and
    two of their standard deviations, and of the true lines that are covered."""
    for low, high in BANDS_M:
        at = (errors.ahead_m >= low) & (errors.ahead_m < high)
        true = (errors.true_ahead_m >= low) & (errors.true_ahead_m < high)
        if not at.any():
            continue
        lateral, height = 100 * errors.lateral_m[at], 100 * errors.height_m[at]
        shares = " | ".join(
            f"{(off[at] < std[at]).mean():.0%}, {(off[at] < 2 * std[at]).mean():.0%}"
            for off, std in (
                (errors.lateral_m, errors.lateral_std_m),
                (errors.height_m, errors.height_std_m),
            )
        )
        yield (
            f"{low} to {high} m | {np.median(lateral):.1f} | {np.quantile(lateral, 0.95):.1f} | "
            f"{np.median(height):.1f} | {np.quantile(height, 0.95):.1f} | {shares} | "
            f"{errors.covered[true].mean():.0%}"
        )


def table(found: Sequence[tuple[Job, LiftErrors, float]]) -> str:
    """Both tables."""
    lines = [
        f"Clips of {FRAMES} frames, {FPS:g} a second, as many of each of "
        f"{' and '.join(f'`{name}`' for name in PRESETS)} with {' and '.join(f'`{name}`' for name in LIDARS)}. "
        "Centimetres.",
        "",
        "| drive | range | across: median | 95 % | height: median | 95 % | within one, two deviations: across | height "
        "| covered |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for case in CASES:
        own = [errors for job, errors, _ in found if job.case.name == case.name]
        name = f"{case.name}: {len(own)} clips"
        for row in rows(together(own)):
            lines.append(f"| {name} | {row} |")
            name = ""
    lines += [
        "",
        "| exact, up to 40 m | across: median | 95 % | height: median | 95 % | points | wrong lines | frames/s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for preset in PRESETS:
        for lidar in LIDARS:
            exact = [
                (errors, seconds)
                for job, errors, seconds in found
                if job.case == CASES[0] and f"{preset}_{lidar}/" in job.url
            ]
            errors = together([errors for errors, _ in exact])
            at = errors.ahead_m < 40
            lateral, height = 100 * errors.lateral_m[at], 100 * errors.height_m[at]
            lines.append(
                f"| `{preset}`, `{lidar}` | {np.median(lateral):.2f} | {np.quantile(lateral, 0.95):.1f} | "
                f"{np.median(height):.2f} | {np.quantile(height, 0.95):.1f} | {at.sum():,} | "
                f"{errors.strays / max(len(at), 1):.1%} | "
                f"{FRAMES * len(exact) / sum(seconds for _, seconds in exact):.1f} |"
            )
    return "\n".join(lines)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--clips", type=click.IntRange(1), default=10, help="Of each preset with each lidar.")
@click.option("--noisy", type=click.IntRange(1), default=10, help="Of these, those that are lifted with noise too.")
@click.option("--workers", type=click.IntRange(1), default=1)
@click.option("--only", default="", help="Cases that begin with this; the page stays as it is.")
def main(folder: Path, clips: int, noisy: int, workers: int, only: str) -> None:
    """Measure what `lift` is worth, on clips with truth."""
    urls = make(folder, clips)
    jobs = [
        Job(url, scene, case, len(urls) * scene + number)
        for case in CASES
        if case.name.startswith(only)
        for number, url in enumerate(urls)
        for scene in Reader(url).scenes[: clips if case == CASES[0] else min(clips, noisy)]
    ]
    found = []
    with process_pool(workers) as pool:
        for done in pool.map(lift, jobs):
            found.append(done)
            click.echo(f"{len(found)}/{len(jobs)} {done[0].url} {done[0].scene} {done[0].case.name}", err=True)
    if only:
        for row in rows(together([errors for _, errors, _ in found])):
            click.echo(row)
        return
    text = table(found)
    page = PAGE.read_text()
    PAGE.write_text(re.sub(r"(?<=<!-- proof -->\n).*?(?=\n<!-- end -->)", lambda _: text, page, flags=re.DOTALL))
    click.echo(text)


if __name__ == "__main__":
    # Processes of a pool know functions of modules alone.
    from scripts import lift_proof

    lift_proof.main()
