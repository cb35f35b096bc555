"""Formats of lines in the image: their points lie on the projected lanes, row by row from the bottom up."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings

from synth3dlanes.formats import culane, curvelanes, tusimple
from synth3dlanes.formats.writing import Pinhole
from tests.formats import closed_form as cf
from tests.formats.random_roads import cameras, roads


def of_file(parse, ending, annotation):
    """The lines of a frame's own file."""
    (text,) = [content for path, content in annotation.files.items() if path.endswith(ending)]
    return parse(text, "test")


def of_rows(annotation):
    """The lines of a frame of tuSimple, which has a column for each row, -2 where there is none."""
    frame = tusimple.parse(annotation.shared[0][0], "test")
    return [np.column_stack([u_px, frame.rows_px])[u_px != -2][::-1] for u_px in frame.lanes_u_px]


# The format, its camera (size, f, how far c is under the middle), the rounding of columns (px), the least and the most
# lines of a frame, and what reads these.
FORMATS = {
    "tusimple": (tusimple, (1280, 720, 2015 * 2 / 3, 0.0), 0.5, (1, 5), of_rows),
    "culane": (culane, (1640, 590, 1420.3, 69.0), 0.001, (1, 4), partial(of_file, culane.parse_lines, ".txt")),
    "curvelanes": (
        curvelanes,
        (2560, 1440, 2217.0, 114.0),
        0.006,
        (2, 99),
        partial(of_file, curvelanes.parse, ".json"),
    ),
}


@pytest.mark.parametrize("name", FORMATS)
@given(cameras, roads)
@settings(max_examples=25, deadline=None)
def test_points_lie_on_the_projected_lanes(name, camera, plan):
    foreign, (width_px, height_px, f_px, below_px), rounding_px, (least, most), lines_of = FORMATS[name]
    labels = cf.road(cf.camera_label(*camera), **plan)
    annotation = foreign.write(replace(cf.frame(Pinhole(width_px, height_px, f_px, below_px)), labels=labels))
    (ids,) = [json.loads(text)["lines_ids"] for text, files in annotation.shared if files == ("sidecar.jsonl",)]
    lines, by_id = lines_of(annotation), {lane.id: lane for lane in labels.lanes}
    assert least <= len(lines) == annotation.n_lines <= most
    for line, lane_id in zip(lines, ids, strict=True):
        right_m, ahead_m, up_m = by_id[lane_id].xyz_cam[by_id[lane_id].xyz_cam[:, 1] > 0.5].T
        u_px = width_px / 2 + f_px * right_m / ahead_m
        v_px = height_px / 2 + below_px - f_px * up_m / ahead_m
        # On the piece of the projected polyline that crosses the row.
        above = np.array([np.flatnonzero(v_px <= v)[0] for v in line[:, 1]])
        share = (line[:, 1] - v_px[above - 1]) / (v_px[above] - v_px[above - 1])
        expected_px = u_px[above - 1] + share * (u_px[above] - u_px[above - 1])
        assert np.abs(line[:, 0] - expected_px).max() <= rounding_px + 1e-6
        assert (np.diff(line[:, 1]) <= -10).all()
        assert set(line[:, 1] % 10) == {0}
        assert ((line[:, 0] >= 0) & (line[:, 0] < width_px)).all()
