"""Where formats file a frame, as loaders look for it, by its part and the parts that the data set has."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.formats.format import open_format
from tests.formats import closed_form as cf

EVERY = ("train", "val", "test")
# A data set with one of val and test uses that as both.
NO_TEST, NO_VAL = ("train", "val"), ("train", "test")
CULANE, ONCE = "driver_000001_30frame/02.MP4/00017", "000001/cam01/00001217"
OPENLANE, CURVELANES = "segment-000012_with_camera_labels/train-00000017", "train_00000017"
# Format, part, parts; the image, the frame's own files, and the lists that name it.
LAYOUTS = [
    *(
        ("culane", part, parts, f"{CULANE}.jpg", {f"{CULANE}.lines.txt", f"laneseg_label_w16/{CULANE}.png"},
         {f"list/{name}.txt" for name in lists} | {"sidecar.jsonl"})
        for part, parts, lists in (
            ("train", EVERY, {"train", "train_gt"}),
            ("val", EVERY, {"val", "val_gt"}),
            ("test", EVERY, {"test", "test_split/test6_curve"}),
            ("test", NO_VAL, {"test", "test_split/test6_curve", "val", "val_gt"}),
        )
    ),
    *(
        ("curvelanes", part, parts, f"{folder}/images/{CURVELANES}.jpg", {f"{folder}/labels/{CURVELANES}.lines.json"},
         {f"{folder}/{folder}.txt", "sidecar.jsonl"})
        for part, parts, folder in (
            ("train", EVERY, "train"), ("val", EVERY, "valid"), ("test", EVERY, "test"), ("test", NO_VAL, "valid")
        )
    ),
    *(
        # PersFormer opens train/ and test/, LATR train/ and val/: FOLDER/*/*/*.json; Anchor3DLane its data_lists.
        ("once", part, parts, f"ONCE_3DLanes/data/{ONCE}.jpg", {f"ONCE_3DLanes/{name}/{ONCE}.json" for name in folders},
         {f"{of}/{name}.txt" for name in folders for of in ("ONCE_3DLanes/list", "data_lists")})
        for part, parts, folders in (
            ("train", NO_TEST, {"train"}),
            ("val", NO_TEST, {"val", "test"}),
            ("test", NO_VAL, {"val", "test"}),
            ("val", EVERY, {"val"}),
            ("test", EVERY, {"test"}),
        )
    ),
    *(
        ("openlane", part, parts, f"images/{folder}/{OPENLANE}.jpg",
         {f"lane3d_1000/{name}/{OPENLANE}.json" for name in (folder, *cases)},
         {f"lists/{folder}.txt", f"data_lists/{folder}.txt", *("lane3d_1000/test/1000_curve.txt" for _ in cases)})
        for part, parts, folder, cases in (
            ("train", EVERY, "training", ()),
            ("val", EVERY, "validation", ("test/curve_case",)),
            ("test", EVERY, "test", ("test/curve_case",)),
            ("test", NO_VAL, "validation", ("test/curve_case",)),
            ("val", NO_TEST, "validation", ("test/curve_case",)),
        )
    ),
]  # fmt: skip


@pytest.mark.parametrize(("name", "part", "parts", "image", "files", "lists"), LAYOUTS)
def test_a_frame_is_where_loaders_look_for_it(name, part, parts, image, files, lists):
    foreign = open_format(name)
    frame = cf.frame(foreign.camera, number=1217, part=part, parts=frozenset(parts), tags=frozenset({"curve"}))
    made = foreign.write(replace(frame, labels=cf.road(cf.camera_label())))
    assert (made.image, {*made.files}) == (image, files)
    assert {path for _, paths in made.shared for path in paths} == lists
    for path, text in made.files.items():
        if name == "once":
            # The first of these words that is anywhere in the path becomes "data".
            word = next(word for word in EVERY if word in path)
            assert path.replace(word, "data").replace(".json", ".jpg") == image
            assert np.shape(json.loads(text)["calibration"]) == (3, 4)
        if name == "openlane":
            assert json.loads(text)["file_path"] == image.removeprefix("images/")
            assert "cam_pitch" not in text
            # PersFormer takes the segment's name by this expression; evaluators replace "jpg" in lines of lists, and
            # Anchor3DLane finds labels by seg*/*.json, and names by what stands before the first dot.
            assert re.findall(r"/segment-(.*)_with_camera_labels", image) == ["000012"]
            assert re.fullmatch(r"lane3d_1000/.*/seg[^/.]*/[^/.]*\.json", path)
            assert f"lane3d_1000/{made.shared[0][0].replace('jpg', 'json')}" in files
        if name in ("once", "openlane"):
            assert "\n" not in text, "loaders read one line"
