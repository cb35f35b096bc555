"""The format kitti."""

from synth3dlanes.formats.format import SampleFormat
from synth3dlanes.formats.kitti.verify import LIMIT_M, LIMIT_PX, read, verify
from synth3dlanes.formats.kitti.write import README, annotate

FORMAT = SampleFormat(
    title="KITTI: 3D boxes of cars, with the points of a lidar",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={"m": LIMIT_M, "px": LIMIT_PX},
    lists=tuple(f"ImageSets/{part}.txt" for part in ("train", "val", "trainval", "test")),
    takes_sweeps=True,
    counted="objects",
)
