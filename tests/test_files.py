"""Nothing is written, replaced or removed through a link below a named folder; only regular files are read."""

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from synth3dlanes.errors import FormatError, InputError
from synth3dlanes.files import Folder, read_bounded

WRITERS: dict[str, Callable[[Folder, str], object]] = {
    "write": lambda folder, path: folder.write(path, b"new"),
    "append": lambda folder, path: folder.append(path).close(),
    "make": lambda folder, path: folder.make(path),
    "remove_tree": lambda folder, path: folder.remove_tree(path),
}
BELOW = WRITERS | {
    "create": lambda folder, path: folder.create(path).close(),
    "remove": lambda folder, path: folder.remove(path),
    "sync": lambda folder, path: folder.sync(path),
}


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """Somebody's documents, outside the folder that is named."""
    folder = tmp_path / "documents"
    (folder / "inner").mkdir(parents=True)
    (folder / "inner/thesis.tex").write_text("years of work")
    return folder


@pytest.mark.parametrize("writer", BELOW)
def test_a_link_in_the_way_is_refused_and_what_it_points_to_stays(tmp_path: Path, elsewhere: Path, writer: str) -> None:
    (tmp_path / "data/train").mkdir(parents=True)
    (tmp_path / "data/train/parts").symlink_to(elsewhere)
    with pytest.raises(InputError, match=r"data/train/parts: expected no link below .*data, got one to .*documents"):
        BELOW[writer](Folder(tmp_path / "data"), "train/parts/inner")
    assert (elsewhere / "inner/thesis.tex").read_text() == "years of work"


@pytest.mark.parametrize("writer", WRITERS)
def test_a_link_at_the_place_itself_is_refused(tmp_path: Path, elsewhere: Path, writer: str) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data/it").symlink_to(elsewhere / "inner/thesis.tex")
    with pytest.raises(InputError, match="data/it: expected no link"):
        WRITERS[writer](Folder(tmp_path / "data"), "it")
    assert (elsewhere / "inner/thesis.tex").read_text() == "years of work"


def test_a_link_as_the_named_folder_is_followed(tmp_path: Path, elsewhere: Path) -> None:
    (tmp_path / "data").symlink_to(elsewhere)
    Folder(tmp_path / "data").write("inner/new", b"text")
    assert (elsewhere / "inner/new").read_bytes() == b"text"


def test_removing_a_tree_removes_links_in_it_and_not_what_they_point_to(tmp_path: Path, elsewhere: Path) -> None:
    (tmp_path / "data/old").mkdir(parents=True)
    (tmp_path / "data/old/link").symlink_to(elsewhere)
    Folder(tmp_path / "data").remove_tree("old")
    assert not (tmp_path / "data/old").exists()
    assert (elsewhere / "inner/thesis.tex").exists()


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write("it", b"old")
    with suppress(KeyboardInterrupt), folder.replacing("it") as stream:
        stream.write(b"ne")
        raise KeyboardInterrupt
    assert (tmp_path / "it").read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["it"]


def test_a_hard_link_is_not_appended_to_and_is_replaced_alone(tmp_path: Path, elsewhere: Path) -> None:
    os.link(elsewhere / "inner/thesis.tex", tmp_path / "it")
    with pytest.raises(InputError, match="expected a file of one name"):
        Folder(tmp_path).append("it")
    Folder(tmp_path).write("it", b"new")
    assert (elsewhere / "inner/thesis.tex").read_text() == "years of work"


def test_only_regular_files_within_the_bound_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    assert read_bounded(tmp_path / "link", 5) == b"12345"
    for name, words in {"pipe": "a pipe", ".": "a folder", "file": "at most 4 bytes, got 5"}.items():
        with pytest.raises(FormatError, match=words):
            read_bounded(tmp_path / name, 4)
    with pytest.raises(FormatError, match="a device"):
        read_bounded(Path("/dev/zero"), 4)
