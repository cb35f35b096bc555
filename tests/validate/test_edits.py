"""Whatever is edited in a data set, `validate` comes back with a report that names it, and nothing that was not."""

import hashlib
import io
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from synth3dlanes.dataset.columns import index_row
from synth3dlanes.dataset.format import BLOCK, COLUMN_OF_MEMBER, HEIGHT, LABELS, PASSES, SCENE, tar_bytes, tar_end
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.params.params import load_params
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.scene.settings import PASSES as ALL_PASSES
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import FormatError
from synth3dlanes.validate.report import ValidationReport
from synth3dlanes.validate.run import validate
from tests.thorough import first
from tests.validate.sealing import Members, check, describe, read_members

pytestmark = pytest.mark.render

N = 8
Rng = np.random.Generator
# A change of one sample's members in place; says what it did, or "" where it did nothing.
Edit = Callable[[Members, Rng], str]
VALUES: list[Any] = [
    None, True, False, 0, -1, 3, 99, 2**70, 10**400, 0.123456, -0.5, 1e-300, 1e9, -1e300,
    "", "x", "\ud800", "a\nb", [], [1], {}, {"a": 1},
]  # fmt: skip


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("edits") / "data"
    recipe = Recipe(Scenes(load_params("tiny"), 3, "train"), RenderSettings(2, ALL_PASSES), "jpg")
    assert generate(Plan(root, N, recipe, workers=1), lambda event: None).exit_code == 0
    return root


@pytest.fixture
def dataset(clean: Path, tmp_path: Path, only: Callable[..., None]) -> Path:
    """A copy, judged by what compares documents."""
    only("index", "form", "labels")
    return Path(shutil.copytree(clean, tmp_path / "data"))


def name(index: int) -> str:
    return f"train:{index:08d}"


# -- edits


def in_json(member: str, *kept: str) -> Edit:
    """One value of a document removed or replaced; those under the keys in `kept` stay."""

    def edit(members: Members, rng: Rng) -> str:
        document = json.loads(members[member])
        said = edit_document(document, rng, kept)
        members[member] = json.dumps(document).encode()
        return said and f"{member}: {said}"

    return edit


def edit_document(document: Any, rng: Rng, kept: tuple[str, ...] = ()) -> str:
    place, steps, value = document, [], document
    while isinstance(value, dict | list) and value and (not steps or rng.random() < 0.85):
        keys = list(value) if isinstance(value, dict) else range(len(value))
        steps.append(keys[rng.integers(len(keys))])
        place, value = value, value[steps[-1]]
    new: Any = VALUES[rng.integers(len(VALUES))]
    match int(rng.integers(6)):
        case 0 if isinstance(place, list) or not has_default(steps[-1], value):
            del place[steps[-1]]
            return said(steps, kept, value, "removed")
        case 1 if type(value) in (int, float):
            new = value + float(rng.choice([1, -1, 0.01, -0.01]))
        case 2 if type(value) in (int, float):
            new = value * float(rng.choice([-1, 2, 0.5, 1.01]))
        case 3 if isinstance(value, list):
            new = [*value, *value[-1:], *([] if value else [1])]
        case 4 if isinstance(value, list):
            new = value[::-1]
    place[steps[-1]] = new
    is_same = new == value and isinstance(new, bool) == isinstance(value, bool)
    return "" if is_same else said(steps, kept, value, new)


def said(steps: list[Any], kept: tuple[str, ...], old: Any, new: Any) -> str:
    """The edit in words; none where it was of what is kept, for other tests."""
    return "" if set(steps) & set(kept) else f"{'.'.join(map(str, steps))}: {old!r:.40} -> {new!r:.40}"


def has_default(key: Any, value: Any) -> bool:
    """Keys that came later may lack, and then have these values."""
    if isinstance(value, dict):
        return key in ("air", "sensor", "assets", "shot") or all(has_default(*item) for item in value.items())
    return value is None or key in ("overcast", "shot") or value in (0, False, [], 1, 1e6)


def in_exr(member: str) -> Edit:
    """Channels removed, added, of another type, of another size, without numbers; or the file cut."""

    def edit(members: Members, rng: Rng) -> str:
        file = OpenEXR.File(io.BytesIO(members[member]), separate_channels=True)
        channels = {name: channel.pixels for name, channel in file.channels().items()}
        name = list(channels)[rng.integers(len(channels))]
        words = ("removed", "of another type", "smaller", "added", "nan", "cut")[rng.integers(6)]
        match words:
            case "removed":
                del channels[name]
            case "of another type":
                channels[name] = np.nan_to_num(channels[name], posinf=9, neginf=0).astype(np.uint32)
            case "smaller":
                channels = {name: np.ascontiguousarray(pixels[:-3, :-2]) for name, pixels in channels.items()}
            case "added":
                channels["more"] = channels[name]
            case "nan":
                channels[name] = np.full_like(channels[name], np.nan)
        stream = io.BytesIO()
        if channels:
            OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(
                stream
            )
        data = stream.getvalue()
        members[member] = data[: int(rng.integers(len(data)))] if words == "cut" else data
        return f"{member}: {name} {words}"

    return edit


def in_image(members: Members, rng: Rng) -> str:
    """The image cut, empty, of another size or format."""
    words = ("cut", "empty", "noise", "smaller", "png")[rng.integers(5)]
    data, stream = members["jpg"], io.BytesIO()
    image = Image.open(io.BytesIO(data))
    match words:
        case "smaller":
            image.resize((40, 30)).save(stream, "JPEG")
        case "png":
            image.save(stream, "PNG")
    made = {"cut": data[: int(rng.integers(len(data) * 3 // 4))], "empty": b"", "noise": rng.bytes(500)}
    members["jpg"] = made.get(words, stream.getvalue())
    return f"jpg: {words}"


# What hides what is a matter of pixels, and has its own tests.
EDITS = [
    in_json(SCENE),
    in_json(LABELS, "object_visible", "car_visible_fraction", "visible_fraction"),
    in_exr(PASSES),
    in_exr(HEIGHT),
    in_image,
]


def seal_as_it_is(root: Path, samples: dict[int, Members]) -> None:
    """Rewrite a split with any bytes; the rows of its index are those of what is there now, if that can be read."""
    path = root / "train/00000.parquet"
    table, data, rows = pq.read_table(path), b"", []
    for row in table.to_pylist():
        members, places, at = samples[row["index"]], {}, len(data)
        for member, content in members.items():
            places[member] = at + BLOCK, len(content)
            at += BLOCK + len(content) + -len(content) % BLOCK
        piece = tar_bytes(row["key"], members)
        data += piece
        rows.append(row_of(row, places, hashlib.sha256(piece).hexdigest(), members, table.schema))
    path.with_suffix(".tar").write_bytes(data + tar_end(len(data)))
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path)


def row_of(
    row: dict[str, Any], places: dict[str, tuple[int, int]], sha256: str, members: Members, schema: pa.Schema
) -> dict[str, Any]:
    try:
        scene, labels = scene_module.from_json(members[SCENE], ""), labels_module.from_json(members[LABELS], "")
        new = index_row(row["key"], places, sha256, scene, labels)
        pa.Table.from_pylist([new], schema=schema)
    except (FormatError, LookupError, ValueError, TypeError, ArithmeticError, pa.ArrowException):
        new = {**row, "sha256": sha256}
        for member, place in places.items():
            new |= zip((f"{COLUMN_OF_MEMBER[member]}_{what}" for what in ("offset", "size")), place, strict=True)
    return new


def one_checked(root: Path) -> ValidationReport:
    """What is said of the files, and of one sample."""
    return validate(root, 1, 1, lambda done, total: None)


def rounds(n: int) -> Iterator[tuple[int, Rng]]:
    return ((seed, np.random.default_rng(seed)) for seed in range(n))


def expect(report: ValidationReport, edited: dict[int, str]) -> None:
    """Every edited sample is named, in lines of text, and no other."""
    assert report.failed == [name(index) for index in sorted(edited)], edited
    json.dumps(report.document())
    for problem in report.problems:
        assert "\n" not in problem.line()
        assert problem.line().encode(), problem
        assert len(problem.line()) < 600


# -- tests


def test_the_data_set_is_clean(clean: Path) -> None:
    assert check(clean).problems == []


@pytest.mark.parametrize("n", [3, pytest.param(60, marks=pytest.mark.slow)])
def test_an_edit_of_any_member_is_found_and_names_its_sample(dataset: Path, n: int) -> None:
    before = read_members(dataset)
    for _, rng in rounds(n):
        samples = {index: dict(members) for index, members in before.items()}
        edited = {}
        for index, members in samples.items():
            words = EDITS[rng.integers(len(EDITS))](members, rng) if rng.random() < 0.9 else ""
            if words:
                edited[index] = words
            else:
                members |= before[index]
        seal_as_it_is(dataset, samples)
        expect(check(dataset), edited)


@pytest.mark.parametrize("n", [1, pytest.param(30, marks=pytest.mark.slow)])
def test_an_edit_of_any_cell_of_the_index_is_found_and_names_its_sample(dataset: Path, n: int) -> None:
    path = dataset / "train/00000.parquet"
    table = pq.read_table(path)
    for _, rng in rounds(n):
        rows, edited = table.to_pylist(), {}
        for index, row in enumerate(rows):
            column = table.column_names[rng.integers(len(table.column_names))]
            # Keys and indices are the names of samples: in the next test.
            if row[column] is None or column in ("key", "index"):
                continue
            is_place = column.endswith(("_offset", "_size"))
            row[column] = other_cell(row[column], rng, may_be_null=not is_place and column != "sha256")
            edited[index] = column
        pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path)
        expect(check(dataset), edited)


def other_cell(value: Any, rng: Rng, may_be_null: bool) -> Any:
    if may_be_null and rng.random() < 0.2:
        return None
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + int(rng.choice([1, -1, 512, -(2**60), 2**60]))
    return value + "\x1b" if isinstance(value, str) else float(rng.choice([value + 1e-5, -value - 1, np.nan, np.inf]))


def test_an_edited_column_of_the_index_is_named_with_both_values(dataset: Path) -> None:
    path = dataset / "train/00000.parquet"
    table = pq.read_table(path)
    rows, expected = table.to_pylist(), {}
    changes: dict[str, Callable[[Any], Any]] = {
        **dict.fromkeys(("lane_width_m", "max_grade", "n_cars"), lambda value: value + 1),
        "flip_lateral": lambda value: not value,
        "junction": lambda value: "nowhere",
        "sha256": lambda value: "0" * 64,
    }
    for row, (column, change) in zip(rows, changes.items(), strict=False):
        before, row[column] = row[column], change(row[column])
        words = f"{column}: expected {json.dumps(before)}, got {json.dumps(row[column])}"
        expected[row["index"]] = "SHA-256" if column == "sha256" else words
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path)
    report = check(dataset)
    assert report.failed == [name(index) for index in expected]
    for index, words in expected.items():
        assert any(words in problem.reason for problem in report.problems if problem.where == name(index)), words


@pytest.mark.parametrize(
    ("column", "change", "words"),
    [
        ("key", lambda values: ["x\n", *values[1:]], "expected key 00000000 for index 0, got 'x\\n'"),
        ("index", lambda values: [-7, *values[1:]], "expected key -0000007 for index -7"),
        ("index", lambda values: [str(value) for value in values], "expected a column index of int64, got string"),
        ("n_cars", lambda values: [float(value) for value in values], "expected a column n_cars of int64, got double"),
        ("scene_offset", lambda values: [None, *values[1:]], "expected a column scene_offset without gaps, got 1"),
        ("marking_wear", None, "expected one column marking_wear, got 0"),
    ],
)
def test_columns_of_another_kind_are_problems_of_their_shard(
    dataset: Path, column: str, change: Callable[[list[Any]], list[Any]] | None, words: str
) -> None:
    path = dataset / "train/00000.parquet"
    table = pq.read_table(path)
    if change is None:
        table = table.drop_columns([column])
    else:
        table = table.set_column(table.column_names.index(column), column, pa.array(change(table[column].to_pylist())))
    pq.write_table(table, path)
    assert any(words in problem.reason for problem in one_checked(dataset).problems)


@pytest.mark.parametrize("n", [10, pytest.param(300, marks=pytest.mark.slow)])
def test_an_edit_of_dataset_json_is_found(dataset: Path, n: int) -> None:
    text = (dataset / "dataset.json").read_text()
    # A licence is what its owner says.
    kept = ("license",)
    for _, rng in rounds(n):
        (dataset / "dataset.json").write_text(text)
        words: list[str] = []
        describe(dataset, lambda document, rng=rng, words=words: words.append(edit_document(document, rng, kept)))
        report = one_checked(dataset)
        if words[0]:
            assert report.problems, words
            json.dumps(report.document())


@pytest.mark.parametrize("n", [3, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("file", ["dataset.json", "train/00000.parquet", "train/00000.tar"])
def test_files_of_damaged_bytes_give_a_report(dataset: Path, file: str, n: int) -> None:
    path = dataset / file
    whole = path.read_bytes()
    for seed, rng in rounds(n):
        data = bytearray(whole)
        for at in rng.integers(len(data), size=3):
            data[at] ^= int(rng.integers(1, 256))
        path.write_bytes(data[: int(rng.integers(len(data)))] if seed % 3 else data)
        report = one_checked(dataset)
        assert report.problems or seed % 3 == 0
        json.dumps(report.document())


@pytest.mark.parametrize("n", [0, -1, 10**12])
def test_any_number_of_samples_may_be_asked_for(dataset: Path, n: int) -> None:
    describe(dataset, lambda document: document.update(splits={"train": {"n": n}}))
    assert one_checked(dataset).problems


def test_lanes_that_are_not_there_and_roads_that_cannot_be_name_their_sample(dataset: Path) -> None:
    changes: list[tuple[str, dict[str, Any], str]] = [
        ("road", {"n_lanes": 8}, "road.n_lanes: expected"),
        ("camera", {"lane": 9}, "camera.lane: expected at most"),
        ("camera", {"height_m": 1e6}, "camera.height_m: expected at most 1000, got 1000000.0"),
        ("markings", {"dash_cycle_m": 1e-9}, "markings.dash_cycle_m: expected at least 0.001, got 1e-09"),
        ("camera", {"fx_px": 1e-200}, "draws: camera.fx_px: expected 83.138396, got 1e-200"),
    ]
    samples = read_members(dataset)
    for index, (group, values, _) in enumerate(changes):
        document = json.loads(samples[index][SCENE])
        document[group] |= values
        samples[index][SCENE] = json.dumps(document).encode()
    closed = next(
        index for index in range(len(changes), N) if json.loads(samples[index][SCENE])["road"]["topology"] > 1
    )
    document = json.loads(samples[closed][SCENE])
    document["road"] |= {"exit_angle_rad": 0, "exit_offset_m": 0}
    samples[closed][SCENE] = json.dumps(document).encode()
    seal_as_it_is(dataset, samples)
    report = check(dataset)
    expected = dict(enumerate(words for *_, words in changes))
    expected[closed] = "exit_angle_rad: expected more than 0 where exit_offset_m is 0"
    assert report.failed == [name(index) for index in expected]
    for index, words in expected.items():
        assert any(words in problem.reason for problem in report.problems if problem.where == name(index)), words


@pytest.mark.parametrize("workers", first(1, [1, 2]))
def test_a_damaged_exr_is_a_finding_and_prints_nothing(
    dataset: Path, capfd: pytest.CaptureFixture[str], workers: int
) -> None:
    samples = read_members(dataset)
    channels = OpenEXR.File(io.BytesIO(samples[1][PASSES]), separate_channels=True).channels()
    stream = io.BytesIO()
    kept = {name: channel.pixels for name, channel in channels.items() if name != "normal.Z"}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, kept).write(stream)
    samples[1][PASSES] = stream.getvalue()
    samples[2][PASSES] = samples[2][PASSES][:-2000]
    seal_as_it_is(dataset, samples)
    capfd.readouterr()
    report = check(dataset, workers)
    assert {problem.where: problem.reason for problem in report.problems} == {
        name(1): "passes.exr: expected channels normal.X, normal.Y, normal.Z, got 2 of them",
        name(2): "passes.exr: expected an OpenEXR image, got other or damaged bytes",
    }
    assert capfd.readouterr() == ("", "")
