"""The format nuscenes."""

from synth3dlanes.formats.format import SampleFormat
from synth3dlanes.formats.nuscenes.convention import LOCATIONS, map_file, mask_file
from synth3dlanes.formats.nuscenes.read import read
from synth3dlanes.formats.nuscenes.tables import document
from synth3dlanes.formats.nuscenes.verify import LIMIT_PX, RULE, verify
from synth3dlanes.formats.nuscenes.write import README, annotate

PLACES = [place for places in LOCATIONS.values() for place in places]

FORMAT = SampleFormat(
    title="nuScenes with its map expansion: cameras, lidar, boxes and maps",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit, "px": LIMIT_PX},
    lists=tuple(path(place) for place in PLACES for path in (map_file, mask_file)),
    document=document,
    takes_sweeps=True,
    counted="lanes",
)
