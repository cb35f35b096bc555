"""`README.md` beside `dataset.json`: what the data set is, in the form that the Hugging Face hub shows."""

from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from synth3dlanes.dataset.description import drive_of, names_of

CARD = "README.md"
# A card is rewritten when the data set grows only if it has this line.
MARK = "<!-- Written by synth3dlanes. Remove this line to keep changes of your own. -->"
# Size categories of the hub: (name, below).
SIZES = (
    ("n<1K", 1e3),
    ("1K<n<10K", 1e4),
    ("10K<n<100K", 1e5),
    ("100K<n<1M", 1e6),
    ("1M<n<10M", 1e7),
    ("10M<n<100M", 1e8),
    ("100M<n<1B", 1e9),
)

_RENDERED = """\
# Synthetic 3D lanes

Rendered road images with exact 3D lane labels: every lane centre line and every painted line as 3D points in metres,
each with masks that say whether it is in the image, hidden by the ground or hidden by a car or tree. The scenes are
those of the synthetic data set of [3D-LaneNet](https://arxiv.org/abs/1811.10203) (Appendix I), or variations of them.
"""

_RENDERED_HOW = """\
{generator}, seed {seed}: {rays} samples per pixel on {device}, {image_format} images, passes: {passes}. Scene i of a
split depends on the seed, the split's name, i and the parameters alone. {shots}{derived}`dataset.json` has the complete
recipe; these are its parameters, as ranges `[low, high]`, weights `{{value: weight}}` or constants:

```yaml
{params}```
"""

_LIFTED = """\
# 3D lanes of a real drive

Images of a real drive with measured 3D lanes: centre lines and delimiters as 3D points in metres, each with its
standard deviations across the lane and in height (`std_m`), and with masks that say whether it is in the image, hidden
by the ground or hidden by things on it.
"""

_LIFTED_HOW = """\
{generator} lifted the drive {drive}: scans put together with its poses, and lanes marked in its images or in its top
view. {shots}How exact the drive was said to be is in `dataset.json` (`derived`). Samples have no scene, and the columns
of the index that describe one are empty.
"""

_TEXT = """\
{about}
| split | samples |
|---|---|
{splits}

## How it was made

{how}
{licence}

## Files

`SPLIT/00000.tar` has the samples 0 to {last}, `SPLIT/00000.parquet` is its index. A sample has these members:

| member | holds |
|---|---|
{members}

All 3D points are in the camera frame: x right, y along the viewing direction, z up, metres. Pixels: u right, v down.

Columns of the index: `key`, `index` and `sha256` of each sample; `*_offset` and `*_size` of its members in the tar;
every parameter of its scene (`n_lanes`, `lane_width_m`, `camera_pitch_rad`, ...); and a summary of its labels
(`junction`, `max_grade`, `n_visible_centerlines`, `terrain_hidden_fraction`, ...).

## How to load it

```python
from datasets import load_dataset

samples = load_dataset("webdataset", data_files={{"{split}": "{split}/*.tar"}}, split="{split}", streaming=True)
```

With synth3dlanes installed, `Reader("DIR/{split}")[0]` is a sample with its image and labels as arrays, and
`synth3dlanes report DIR` writes a page with samples and statistics.
"""

_MEMBERS = {
    "image": "the image",
    "scene.json": "the complete scene that was rendered",
    "labels.json": "lanes, camera and lane graph",
    "passes.exr": "passes in the image's pixels, as OpenEXR",
    "height.exr": "heights over the road plane seen from above, as OpenEXR",
    "lidar.exr": "a lidar's sweep as a range image with ids, as OpenEXR",
}


def card(description: Mapping[str, Any]) -> bytes:
    """The text of the card, from the contents of `dataset.json`. Equal contents give equal bytes."""
    splits = {name: int(split["n"]) for name, split in description["splits"].items()}
    licence = description.get("license")
    render = description["render"]
    names = names_of(description)
    first = "train" if "train" in splits else next(iter(splits), "train")
    is_measured = drive_of(description) is not None
    how = (_LIFTED_HOW if is_measured else _RENDERED_HOW).format(
        generator=f"synth3dlanes {description['generator']}",
        seed=description["seed"],
        rays=render["samples"],
        device=render["device"],
        image_format=description["image_format"],
        passes=", ".join(render["passes"]) or "none",
        shots="".join(f"{sentence} " for sentence in _shots(description)),
        derived="The samples were taken from another data set (`derived`). " if description.get("derived") else "",
        drive=drive_of(description),
        params=yaml.safe_dump(description["params"], sort_keys=False, default_flow_style=None, width=110),
    )
    theirs = "the drive's images" if is_measured else "the assets used"
    text = _TEXT.format(
        about=_LIFTED if is_measured else _RENDERED,
        how=how,
        splits="\n".join(f"| {name} | {n:,} |" for name, n in splits.items()),
        licence=f"Licence: {licence}." if licence else f"The licence is that of {theirs}, which is not recorded.",
        last=int(description["shard_size"]) - 1,
        members="\n".join(f"| `.{name}` | {_MEMBERS.get(name, _MEMBERS['image'])} |" for name in names),
        split=first,
    )
    return f"---\n{_header(splits, licence, is_measured)}---\n{MARK}\n\n{text}".encode()


def _shots(description: Mapping[str, Any]) -> Iterator[str]:
    """What a sample shows of its scene, as text; "" for a single picture by the camera of the parameters."""
    shots = description.get("shots", {})
    frames, n_cameras = shots.get("frames", 1), len(shots.get("cameras", ()))
    if shots.get("views", 1) > 1:
        yield f"Each world is seen from {shots['views']} places, one after the other."
    if frames > 1:
        yield f"Scenes are clips of {frames} frames, one sample each."
    if n_cameras > 1:
        yield f"Each moment is seen by {n_cameras} cameras, one sample each (`shots`)."
    elif n_cameras:
        yield "The camera is that of `shots`, not that of the parameters."
    if shots.get("lidar"):
        yield "A lidar measures each moment (`shots`)."
    if description.get("like"):
        yield "Scenes are near given ones (`like`)."
    if description.get("where"):
        yield f"Each scene is the first one drawn for it where `{description['where']}`."


def _header(splits: Mapping[str, int], licence: str | None, is_measured: bool) -> str:
    """The metadata that the hub reads: licence, task, size, and which files belong to which split."""
    n = sum(splits.values())
    header: dict[str, Any] = {
        **({"license": licence.lower()} if licence else {}),
        "pretty_name": "3D lanes of a real drive" if is_measured else "Synthetic 3D lanes",
        "task_categories": ["object-detection", "depth-estimation"],
        "tags": ["3d-lane-detection", "autonomous-driving", *([] if is_measured else ["synthetic"])],
        "size_categories": [next((name for name, below in SIZES if n < below), "n>1T")],
        "configs": [
            {
                "config_name": "default",
                # The hub allows no hyphens in names of splits.
                "data_files": [{"split": name.replace("-", "_"), "path": f"{name}/*.tar"} for name in splits],
            }
        ],
    }
    return yaml.safe_dump(header, sort_keys=False)
