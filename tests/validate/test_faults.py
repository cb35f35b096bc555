"""Every planted fault is found, and named by sample, lane and reason; the dataset that they are planted in is clean."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from synth3dlanes.dataset.format import LABELS, SCENE, decode_image, encode_image, tar_bytes
from synth3dlanes.dataset.read import Reader
from synth3dlanes.labels.labels import Labels, Lane
from synth3dlanes.validate.findings import Own, Problem
from synth3dlanes.validate.integrity import walk
from synth3dlanes.validate.report import ValidationReport
from tests.thorough import first
from tests.validate import examining
from tests.validate.conftest import N
from tests.validate.examining import evidence_of
from tests.validate.sealing import Change, check, describe, drop_passes, read_members, relabel, seal

pytestmark = pytest.mark.render

SAMPLE = 1
NAME = "train:00000001"


def line_to_spoil(labels: Labels) -> Lane:
    """The delimiter with most seen points nearby."""
    lines = [lane for lane in labels.lanes if lane.kind == "delimiter"]
    return max(lines, key=lambda lane: (lane.visible & (lane.xyz_cam[:, 1] < 25)).sum())


def with_lane(labels: Labels, lane: Lane) -> Labels:
    return replace(labels, lanes=tuple(lane if lane.id == old.id else old for old in labels.lanes))


def reasons(report: ValidationReport, where: str, lane: str) -> str:
    return "\n".join(problem.reason for problem in report.problems if (problem.where, problem.lane) == (where, lane))


def spoilt_lane(root: Path) -> str:
    return line_to_spoil(Reader(f"{root}/train").labels(SAMPLE)).id


def test_a_clean_dataset_passes_with_and_without_passes(dataset):
    report = check(dataset)
    assert report.problems == []
    assert report.n_samples == N
    asked = {
        "points.ground_m",
        "points.depth_m",
        "points.object_visible",
        "pavement.surface",
        "terrain.hills",
        "ids.car",
    }
    assert asked <= {*report.numbers}
    drop_passes(dataset)
    report = check(dataset)
    assert report.problems == []
    assert {"ridges.in_place", "points.ground_m"} <= {*report.numbers}
    assert not {"points.depth_m", "ids.car"} & {*report.numbers}


def shifted(labels: Labels) -> Labels:
    lane = line_to_spoil(labels)
    return with_lane(labels, replace(lane, xyz_cam=lane.xyz_cam + np.array([0.5, 0, 0])))


def test_a_lane_shifted_by_half_a_metre_is_found_by_scene_and_paint_and_image(dataset, only):
    only("form", "labels", "points", "ridges")
    lane = spoilt_lane(dataset)
    seal(dataset, relabel(SAMPLE, shifted))
    report = check(dataset)
    assert report.failed == [NAME]
    found = reasons(report, NAME, lane)
    for words in ("xyz_cam.0.0: expected", "image: expected the line's paint"):
        assert words in found
    assert {problem.lane for problem in report.problems} == {lane}
    drop_passes(dataset)
    assert "image: expected the line's paint" in reasons(check(dataset), NAME, lane)


def test_a_truncated_tar_is_found_with_the_samples_that_it_has_lost(dataset, only):
    only()
    tar = dataset / "train/00000.tar"
    last = max(offset + size for name, offset, size in walk(str(tar))[0] if name.startswith("00000002"))
    with tar.open("r+b") as stream:
        stream.truncate(last - 1000)
    report = check(dataset)
    assert {"train:00000002", "train:00000003", "train/00000.tar"} == set(report.failed)
    assert "got a cut or changed tar" in reasons(report, "train:00000003", "")
    assert report.n_samples == 2


def test_a_duplicated_key_is_found_in_the_index_and_in_the_tar(dataset, only):
    only()
    parquet = dataset / "train/00000.parquet"
    rows = pq.read_table(parquet)
    pq.write_table(pa.concat_tables([rows, rows.slice(SAMPLE, 1)]), parquet)
    assert "expected this key once in the index" in reasons(check(dataset), NAME, "")
    pq.write_table(rows, parquet)
    raw = Reader(f"{dataset}/train").raw(SAMPLE)
    with (dataset / "train/00000.tar").open("r+b") as stream:
        _, offset, size = walk(f"{dataset}/train/00000.tar")[0][-1]
        stream.seek(offset + size + -size % 512)
        stream.write(tar_bytes("00000001", raw) + bytes(10240))
    assert "once in" in reasons(check(dataset), NAME, "")


def test_one_changed_byte_of_a_sample_is_found(dataset, only):
    only()
    tar = dataset / "train/00000.tar"
    offset = next(offset for name, offset, _ in walk(str(tar))[0] if name == "00000001.jpg")
    data = bytearray(tar.read_bytes())
    data[offset + 5000] ^= 1
    tar.write_bytes(data)
    report = check(dataset)
    assert report.failed == [NAME]
    assert "SHA-256" in reasons(report, NAME, "")


def test_a_missing_sample_is_named(dataset, only):
    only()
    seal(dataset, lambda samples: samples.pop(SAMPLE) and None)
    assert check(dataset).problems == [Problem("train", "", "expected 4 samples, 1 missing: 00000001")]


def test_a_scene_in_two_splits_is_found_whatever_its_index(dataset, only):
    only()
    shutil.copytree(dataset / "train", dataset / "test")
    describe(dataset, lambda document: document["splits"].update(test={"n": 1}))

    def keep_third_as_first(samples: dict[int, dict[str, bytes]]) -> None:
        third = samples[2]
        third[SCENE] = json.dumps(json.loads(third[SCENE]) | {"split": "test", "index": 0}).encode()
        samples.clear()
        samples[0] = third

    seal(dataset, keep_third_as_first, "test")
    report = check(dataset)
    assert report.failed == ["test:00000000"]
    own, redrawn = sorted(reasons(report, "test:00000000", "").splitlines())
    assert own == "expected a scene of its own, got that of train:00000002"
    assert redrawn.startswith("scene.json: not what dataset.json draws: ")


def test_a_picture_of_another_frame_is_found_but_not_one_of_a_host_that_stands(dataset, only):
    only()
    seal(dataset, lambda samples: samples[2].update(jpg=samples[SAMPLE]["jpg"]))
    report = check(dataset)
    assert report.problems == [Problem("train:00000002", "", f"expected a picture of its own, got that of {NAME}")]
    standing = ValidationReport()
    for i in range(2):
        standing.sample(f"train:{i:08d}", [Own("picture", "equal bytes", at="one place")])
    assert standing.problems == []


def spoil_scene(samples: dict[int, dict[str, bytes]]) -> None:
    samples[0][SCENE] = json.dumps(json.loads(samples[0][SCENE]) | {"index": 7}).encode()


def spoil_image(samples: dict[int, dict[str, bytes]]) -> None:
    samples[1]["jpg"] = encode_image(decode_image(samples[1]["jpg"], "")[:-2], "jpg")


def of_line(**changes: Callable[[np.ndarray], object]) -> Callable[[Labels], Labels]:
    """A change of fields of the line with most seen points."""

    def change(labels: Labels) -> Labels:
        lane = line_to_spoil(labels)
        return with_lane(labels, replace(lane, **{name: of(getattr(lane, name)) for name, of in changes.items()}))

    return change


def first_other(name: str, old: object, new: object) -> Callable[[Labels], Labels]:
    """Another value for the first lane that has one."""

    def change(labels: Labels) -> Labels:
        line = next(lane for lane in labels.lanes if getattr(lane, name) == old)
        return with_lane(labels, replace(line, **{name: new}))

    return change


def pitch(labels: Labels) -> Labels:
    return replace(labels, camera=replace(labels.camera, pitch_rad=labels.camera.pitch_rad + 0.01))


# What the checks of form, labels and points say of changed labels.
OF_LABELS: dict[str, tuple[Callable[[Labels], Labels], tuple[str, ...]]] = {
    "another pitch": (pitch, ("camera.pitch_rad: expected",)),
    "points from last to first": (
        of_line(xyz_cam=lambda points: np.ascontiguousarray(points[::-1])),
        ("expected points in driving order",),
    ),
    "another colour": (first_other("color", "white", "yellow"), ('color: expected "white", got "yellow"',)),
    "a double line": (first_other("double", old=False, new=True), ("double: expected false, got true",)),
    "points 10 cm up": (of_line(xyz_cam=lambda points: np.add(points, (0, 0, 0.1))), ("m of the ground",)),
    "terrain_visible flipped": (
        of_line(terrain_visible=np.logical_not),
        ("terrain_visible.0: expected", "terrain_visible: expected what the passes show"),
    ),
    "in_image flipped": (
        of_line(in_image=np.logical_not),
        ("in_image: expected the mask of our projection", "in_image.0: expected"),
    ),
    "object_visible flipped": (
        of_line(object_visible=np.logical_not),
        ("object_visible: expected what the passes show",),
    ),
}


@pytest.mark.parametrize("name", first(4, OF_LABELS))
def test_a_fault_of_labels_is_found(rendered, name):
    change, words = OF_LABELS[name]
    evidence = evidence_of(read_members(rendered)[SAMPLE])
    found = examining.reasons(replace(evidence, labels=change(evidence.labels)), "form", "labels", "points")
    assert all(word in found for word in words), found


def test_what_does_not_fit_its_scene_or_schema_is_found_and_names_its_sample(dataset, only):
    only("index", "form", "labels")
    changes: dict[str, Change] = {
        "index: expected 0, got 7": spoil_scene,
        "expected 480x360 pixels, got 480x358": spoil_image,
        "left: expected the id of a line of the other kind": relabel(2, of_line(left=lambda _: "main_99")),
        "expected unique ids of lanes": relabel(3, lambda of: replace(of, lanes=(*of.lanes, of.lanes[0]))),
    }
    seal(dataset, lambda samples: [change(samples) for change in changes.values()] and None)
    report = check(dataset)
    names = [f"train:{index:08d}" for index in range(N)]
    assert report.failed == names
    for name, words in zip(names, changes, strict=True):
        assert any(words in problem.line() for problem in report.problems if problem.where == name)


def test_labels_out_of_shape_are_found(dataset):
    spoils = {
        1: (lambda lane: lane["in_image"].pop(), "lanes.0: in_image: expected a value for each of"),
        2: (lambda lane: lane["xyz_cam"][3].pop(), "labels.json: lanes.0.xyz_cam.3.2: missing"),
        3: (lambda lane: lane.pop("marking"), "labels.json: lanes.0.marking: missing"),
    }
    reader, tar = Reader(f"{dataset}/train"), dataset / "train/00000.tar"
    places = {name: (offset, size) for name, offset, size in walk(str(tar))[0]}
    for index, (spoil, _) in spoils.items():
        document = json.loads(reader.raw(index)[LABELS])
        spoil(document["lanes"][0])
        offset, size = places[f"{index:08d}.{LABELS}"]
        with tar.open("r+b") as stream:
            stream.seek(offset)
            stream.write(json.dumps(document, separators=(",", ":")).encode().ljust(size))
    # In processes of their own, where no shape checks of the tests step in before.
    report = check(dataset, workers=2)
    for index, (_, words) in spoils.items():
        where = f"train:{index:08d}"
        assert any(problem.where == where and words in problem.reason for problem in report.problems)


def test_the_command_exits_with_1_names_faults_in_lines_and_leaves_a_picture(dataset, only):
    from synth3dlanes_cli.main import main

    clean = CliRunner().invoke(main, ["validate", str(dataset), "--workers", "2", "--limit", "2", "--json"])
    assert clean.exit_code == 0
    assert json.loads(clean.stdout)["problems"] == []
    assert not (dataset / "validation").exists()
    only("labels")
    lane = spoilt_lane(dataset)
    seal(dataset, relabel(SAMPLE, shifted))
    result = CliRunner().invoke(main, ["validate", str(dataset), "--workers", "1"])
    assert result.exit_code == 1
    assert any(line.startswith(f"{NAME}: {lane}: ") for line in result.stdout.splitlines())
    assert (dataset / "validation/train-00000001.png").stat().st_size > 10_000
    assert CliRunner().invoke(main, ["validate", str(dataset), "--limit", "1"]).exit_code == 0
    assert CliRunner().invoke(main, ["validate", str(dataset / "nowhere")]).exit_code == 2
