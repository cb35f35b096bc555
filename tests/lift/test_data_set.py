"""A lifted drive is a data set as any other."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from synth3dlanes_cli.main import main

from synth3dlanes import labels as labels_format
from synth3dlanes.dataset.read import Reader
from synth3dlanes.errors import FormatError, InputError
from synth3dlanes.formats.export import Export
from synth3dlanes.lift.precision import NO_ERROR
from synth3dlanes.lift.write import LiftReport, lift_to
from synth3dlanes.validate.run import validate
from synth3dlanes.validate.structure import check_measured
from tests.drives.road import road, write_described
from tests.lift import hill


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, LiftReport]:
    out = tmp_path_factory.mktemp("lifted") / "set"
    return out, lift_to(hill.drive(8), out, precision=NO_ERROR)


def test_it_has_every_frame_with_its_lanes(made: tuple[Path, LiftReport]) -> None:
    out, report = made
    reader = Reader(f"{out}/train")
    assert (len(reader), report.frames, report.frames_without_lanes) == (8, 8, 0)
    assert reader.clip(0) == list(range(8))
    for sample in reader:
        assert sample.image.shape == (720, 1280, 3)
        assert all(
            lane.std_m is not None and lane.std_m.shape == (len(lane.xyz_cam), 2) for lane in sample.labels.lanes
        )
    description = json.loads((out / "dataset.json").read_text())
    assert "license" not in description
    assert description["derived"]["lifted"] == "hill"
    for name in ("README.md", "croissant.json"):
        text = (out / name).read_text()
        assert "real drive" in text
        assert "synthetic" not in text.lower()


def test_lifting_again_adds_nothing(made: tuple[Path, LiftReport]) -> None:
    out, _ = made
    before = (out / "train/00000.tar").read_bytes()
    lift_to(hill.drive(8), out, precision=NO_ERROR)
    assert (out / "train/00000.tar").read_bytes() == before
    with pytest.raises(InputError, match="precision"):
        lift_to(hill.drive(8), out, precision=replace(NO_ERROR, lanes_px=3.0))


def test_it_passes_validate(made: tuple[Path, LiftReport]) -> None:
    report = validate(made[0], 1, None, lambda done, total: None)
    assert not report.problems
    with pytest.raises(InputError, match="rerender: expected a data set of scenes, got one lifted"):
        validate(made[0], 1, None, lambda done, total: None, rerender=1)


def test_openlane_takes_it(made: tuple[Path, LiftReport], tmp_path: Path) -> None:
    summary = Export(str(made[0]), tmp_path / "openlane", "openlane").write(1)
    assert sum(summary.n_frames.values()) == 8
    assert summary.n_lines >= 8


def test_formats_that_say_more_than_lanes_do_not_take_it(made: tuple[Path, LiftReport], tmp_path: Path) -> None:
    """They would have the placeholder's road, or lack objects and passes."""
    for name in ("argoverse2", "coco", "kitti", "masks", "opendrive", "openlane_v2", "yolo"):
        with pytest.raises(InputError, match=f"expected a data set of scenes for {name}, got one that was lifted"):
            Export(str(made[0]), tmp_path / name, name).write(1)


def test_faults_of_measured_labels_are_found(made: tuple[Path, LiftReport]) -> None:
    labels = Reader(f"{made[0]}/train").labels(0)
    lane = labels.lanes[0]
    assert not list(check_measured(labels))
    turned = labels.camera.world_from_cam @ np.diag([-1.0, 1, 1, 1])
    faults = {
        "std_m: expected how certain": replace(lane, std_m=None),
        "in_image: expected the mask": replace(lane, in_image=~lane.in_image),
        "expected points that advance": replace(lane, xyz_cam=lane.xyz_cam[np.r_[1, 0, 2 : len(lane.xyz_cam)]]),
    }
    for words, wrong in faults.items():
        found = list(check_measured(replace(labels, lanes=(wrong, *labels.lanes[1:]))))
        assert any(words in finding.reason for finding in found), words
    mirrored = replace(labels, camera=replace(labels.camera, world_from_cam=turned))
    assert any("world_from_cam: expected a rotation" in finding.reason for finding in check_measured(mirrored))


def test_how_certain_points_are_lasts(made: tuple[Path, LiftReport]) -> None:
    labels = Reader(f"{made[0]}/train").labels(0)
    text = labels_format.to_json(labels)
    again = labels_format.from_json(text, "labels")
    assert labels_format.to_json(again) == text
    document = json.loads(text)
    del document["lanes"][0]["std_m"][0]
    with pytest.raises(FormatError, match="std_m: expected a pair for each of"):
        labels_format.from_json(json.dumps(document), "labels")


def test_the_command_lifts_a_drive_of_ones_own_files(tmp_path: Path) -> None:
    """A level road with lanes 1.75 m to both sides, written without our code."""
    drive = write_described(tmp_path, road(n=14, turn=0.0))
    (drive / "drive.yaml").write_text((drive / "drive.yaml").read_text().replace("marked: lanes.geojson\n", ""))
    out = tmp_path / "out"
    words = ["lift", str(drive), "--out", str(out), "--json", "--unchecked"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout.splitlines()[-1])["frames"] == 14
    asides = []
    for i in range(4):
        labels = Reader(f"{out}/train").labels(i)
        assert abs(labels.camera.height_m - 1.5) < 0.03
        asides += [np.median(lane.xyz_cam[:, 0]) for lane in labels.lanes if lane.kind == "delimiter"]
    nearest = np.abs(np.array(asides)[:, None] + np.array([-1.75, 1.75, 5.25])).min(axis=1)
    assert len(asides) >= 8
    assert nearest.max() < 0.1


def test_a_wrong_precision_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(
        main, ["lift", "nothing", "--out", str(tmp_path / "out"), "--precision", "lanes_px=two"]
    )
    assert result.exit_code == 2
    assert "expected NAME=NUMBER, got 'lanes_px=two'" in result.output
