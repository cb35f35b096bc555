"""`export --verify` over files of its own that were damaged: each is told in lines that name it, whatever is in it."""

import os
import re
import shutil

import pytest

from synth3dlanes.formats.export import Export
from synth3dlanes.formats.format import format_names
from synth3dlanes.formats.verify import verify
from synth3dlanes.system.errors import Synth3dlanesError
from tests.hostile import LEAKED
from tests.thorough import first

BOMB = '<!DOCTYPE a [<!ENTITY b "x"><!ENTITY c "' + "&b;" * 50 + '">]><OpenDRIVE>&c;</OpenDRIVE>'


def _first_number(data, by):
    return re.sub(rb"(?<=[ :\[\"])-?\d+(\.\d+)?", by, data, count=1)


def _all_numbers(data, by):
    return re.sub(rb"(?<=[ :\[\"])-?\d+\.\d+", by, data)


DAMAGE = {
    "empty": lambda data: b"",
    "half": lambda data: data[: len(data) // 2],
    "binary": lambda data: bytes(range(256)) * 8,
    "zeros": lambda data: b"\0" * 100,
    "null": lambda data: b"null\n",
    "list": lambda data: b"[]\n",
    "object": lambda data: b"{}\n",
    "text": lambda data: b'"x"\n',
    "deep": lambda data: b"[" * 50_000,
    "deep object": lambda data: b'{"lanes":' * 5_000,
    "not a number": lambda data: _first_number(data, b"NaN"),
    "no numbers": lambda data: _all_numbers(data, b"NaN"),
    "endless": lambda data: _first_number(data, b"1e400"),
    "huge": lambda data: _all_numbers(data, b"1e308"),
    "far": lambda data: _first_number(data, b"999999999999"),
    "equal": lambda data: _all_numbers(data, b"7.0"),
    "elsewhere": lambda data: re.sub(rb"(?<=[\n\"/ ])[\w./-]+\.jpg", b"../../x.jpg", data),
    "no keys": lambda data: re.sub(rb'"(\w+)":', rb'"other_\1":', data),
    "texts": lambda data: re.sub(rb": *-?\d+", b': "x"', data),
    "bomb": lambda data: BOMB.encode(),
    "no attributes": lambda data: re.sub(rb' (s|a|x|length|id)="[^"]*"', b"", data),
    "twice": lambda data: data + data,
}
ANY = ("empty", "half", "binary", "zeros")
OF_NUMBERS = ("not a number", "endless", "huge", "far", "equal", "twice", "elsewhere")
OF_JSON = ("null", "list", "object", "text", "deep", "deep object", "no numbers", "no keys", "texts")
OF_KIND = {
    ".txt": (*ANY, *OF_NUMBERS),
    ".json": (*ANY, *OF_NUMBERS, *OF_JSON),
    ".jsonl": (*ANY, *OF_NUMBERS, *OF_JSON),
    ".xodr": (*ANY, *OF_NUMBERS, "no numbers", "bomb", "no attributes"),
    ".jpg": ANY,
    ".png": ANY,
}
# Whatever is in their place must be found.
OTHER = ("binary", "zeros", "bomb")
# Files that people and tools read, but `verify` does not.
UNREAD = {".parts", "README.md", "classes.json", "data.yaml", "data_lists"}


# KITTI has objects only where somebody has seen them, Cosmos has clips: they have tests of their own. nuScenes has 36
# files, each of which is damaged.
NAMES = first(12, sorted({*format_names()} - {"cosmos", "kitti"}, key=lambda name: (name == "nuscenes", name)))


@pytest.fixture(params=NAMES)
def exported(request, export_of, tmp_path):
    whole = export_of(request.param)
    return Export(whole.source, shutil.copytree(whole.out, tmp_path / "out", symlinks=True), request.param)


def files_to_damage(out):
    """One of each kind, by its path but for its numbers, of those that hold something."""
    kinds = {}
    for path in sorted(out.rglob("*")):
        within = path.relative_to(out)
        if path.is_file() and not path.is_symlink() and within.parts[0] not in UNREAD and path.stat().st_size:
            # The tables of both versions of nuScenes are alike.
            kinds.setdefault(re.sub(r"\d+", "0", str(within)).replace("trainval", "test"), path)
    return [path for path in kinds.values() if "test_tasks" not in path.name]


def told(job, most_frames=2):
    """What `verify` says, in lines; anything but one of our errors fails the test."""
    try:
        return [problem for result in verify(job, most_frames) for problem in result.problems]
    except Synth3dlanesError as error:
        return str(error).splitlines()


@pytest.mark.parametrize("every", [9, pytest.param(2, marks=pytest.mark.thorough)])
def test_damaged_files_are_told_in_lines(exported, every):
    """One in nine kinds of damage to each file, other ones to the next file; or one in two."""
    check_damaged_files(exported, every)


def check_damaged_files(exported, every):
    """Damage one of each kind of file of an export, in one of `every` ways of those for its kind."""
    out = exported.out
    for number, path in enumerate(files_to_damage(out)):
        whole = path.read_bytes()
        for name in OF_KIND.get(path.suffix, ANY)[number % every :: every]:
            damaged = DAMAGE[name](whole)
            if damaged == whole:
                continue
            path.write_bytes(damaged)
            lines = told(exported, 2 if name in OTHER else 1)
            where = f"{path.relative_to(out)}: {name}: {lines}"
            assert not any(LEAKED.search(line) or len(line) > 2000 for line in lines), where
            assert lines or name not in OTHER, where
        path.unlink()
        assert told(exported), f"{path.relative_to(out)}: gone"
        os.mkfifo(path)
        assert told(exported), f"{path.relative_to(out)}: a pipe"
        path.unlink()
        path.write_bytes(whole)
    assert not told(exported)


@pytest.mark.parametrize("format_name", first(1, ["openlane", "coco"]))
def test_damaged_marks_are_told_in_lines(format_name, export_of, two_frames, tmp_path):
    out = shutil.copytree(export_of(format_name).out, tmp_path / "out", symlinks=True)
    for path in [*(out / ".parts").iterdir(), out / "export.json"]:
        whole = path.read_bytes()
        for name in OF_KIND[path.suffix] if path.suffix else ():
            path.write_bytes(DAMAGE[name](whole))
            assert not LEAKED.search(refusal(two_frames, out, format_name)), (path.name, name)
            path.write_bytes(whole)


def refusal(source, out, format_name):
    """Why an export cannot go on; "" where it can."""
    try:
        Export(str(source), out, format_name).write()
    except Synth3dlanesError as error:
        return str(error)
    return ""
