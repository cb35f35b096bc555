"""Nothing is written, replaced or removed through a link below a named folder; only regular files are read."""

import errno
import os
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from PIL import Image

from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import Folder, encoded, read_bounded, write
from tests.small_files import small_files

WRITERS: dict[str, Callable[[Folder, str], object]] = {
    "write": lambda folder, path: folder.write(path, b"new"),
    "renew": lambda folder, path: folder.renew(path).close(),
    "append": lambda folder, path: folder.append(path).close(),
    "update": lambda folder, path: folder.update(path).close(),
    "take": lambda folder, path: folder.take(path, Path(__file__)),
    "link": lambda folder, path: folder.link(path, "anywhere"),
    "make": lambda folder, path: folder.make(path),
    "remove_tree": lambda folder, path: folder.remove_tree(path),
    "expect_file": lambda folder, path: folder.expect_file(path),
}
BELOW = WRITERS | {
    "remove": lambda folder, path: folder.remove(path),
    "remove_empty": lambda folder, path: folder.remove_empty(path),
    "make_in": lambda folder, path: folder.make_in(path),
    "is_folder": lambda folder, path: folder.is_folder(path),
    "remove_unfinished": lambda folder, path: folder.remove_unfinished(path),
    "sync": lambda folder, path: folder.sync(path),
    "names": lambda folder, path: folder.names(path),
    "exists": lambda folder, path: folder.exists(path),
}


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """Somebody's documents, outside the folder that is named."""
    folder = tmp_path / "documents"
    (folder / "inner").mkdir(parents=True)
    (folder / "inner/thesis.tex").write_text("years of work")
    return folder


@pytest.mark.parametrize(
    ("writer", "place"),
    [*((name, "train/parts/inner") for name in BELOW), *((name, "train/parts") for name in WRITERS)],
)
@pytest.mark.parametrize("target", ["documents", "documents/inner/thesis.tex"])
def test_a_link_in_the_way_is_refused_and_what_it_points_to_stays(
    tmp_path: Path, elsewhere: Path, writer: str, place: str, target: str
) -> None:
    """Above the place, or at the place itself."""
    (tmp_path / "data/train").mkdir(parents=True)
    (tmp_path / "data/train/parts").symlink_to(tmp_path / target)
    with pytest.raises(InputError, match=r"data/train/parts: expected no"):
        BELOW[writer](Folder(tmp_path / "data"), place)
    assert (tmp_path / "data/train/parts").is_symlink()
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


def test_a_file_named_by_the_user_is_not_written_through_a_link(tmp_path: Path, elsewhere: Path) -> None:
    (tmp_path / "page.html").symlink_to(elsewhere / "inner/thesis.tex")
    with pytest.raises(InputError, match=r"page\.html: expected no link"):
        write(tmp_path / "page.html", b"new")
    write(tmp_path / "new/page.html", b"new")
    assert (tmp_path / "new/page.html").read_bytes() == b"new"
    assert (elsewhere / "inner/thesis.tex").read_text() == "years of work"


def test_a_link_that_comes_while_a_file_is_written_is_replaced(tmp_path: Path, elsewhere: Path) -> None:
    with Folder(tmp_path).replacing("it") as stream:
        stream.write(b"new")
        (tmp_path / "it").symlink_to(elsewhere / "inner/thesis.tex")
    assert (tmp_path / "it").read_bytes() == b"new"
    assert not (tmp_path / "it").is_symlink()
    assert (elsewhere / "inner/thesis.tex").read_text() == "years of work"


def test_a_file_and_a_folder_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="file: expected a folder, got a file"):
        Folder(tmp_path).make("file")
    with pytest.raises(InputError, match="folder: expected a file, got a folder"):
        Folder(tmp_path).write("folder", b"")


def test_what_a_killed_writer_left_is_found(tmp_path: Path) -> None:
    (tmp_path / ".it.other").touch()
    (tmp_path / ".it.0123456789abcdef.tmp").touch()
    (tmp_path / ".it.4711.tmp").symlink_to(tmp_path / ".it.other")
    Folder(tmp_path).remove_unfinished("it")
    assert os.listdir(tmp_path) == [".it.other"]
    (tmp_path / ".other.0123456789abcdef.tmp").touch()
    (tmp_path / ".theirs.tmp").touch()
    Folder(tmp_path).remove_all_unfinished()
    assert sorted(os.listdir(tmp_path)) == [".it.other", ".theirs.tmp"]


def test_what_a_living_writer_has_begun_stays(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    with folder.replacing("it") as stream:
        stream.write(b"new")
        folder.remove_unfinished("it")
        folder.remove_all_unfinished()
        write(tmp_path / "it", b"other")
    assert (tmp_path / "it").read_bytes() == b"new"


def test_a_full_disk_is_told_with_the_file(tmp_path: Path) -> None:
    """Whichever way the file is written, at the latest when it is closed."""
    folder = Folder(tmp_path)
    with small_files(100):
        for opened in (folder.replacing, folder.renew, folder.append):
            for size in (101, 100_000):
                with pytest.raises(OSError, match="File too large") as caught, opened("it") as stream:
                    stream.write(bytes(size))
                assert caught.value.filename == str(tmp_path / "it")


def test_libraries_do_not_get_the_descriptor(tmp_path: Path) -> None:
    """Pillow writes to it, and does not look how much of a JPEG was written."""
    image = Image.effect_noise((256, 256), 100)
    for opened in (Folder(tmp_path).replacing, Folder(tmp_path).renew):
        with small_files(4096), pytest.raises(OSError, match="File too large"), opened("it.jpg") as stream:
            image.save(stream, "JPEG")
    with Folder(tmp_path).replacing("it.jpg") as stream:
        image.save(stream, "JPEG")
    assert (tmp_path / "it.jpg").read_bytes() == encoded(lambda stream: image.save(stream, "JPEG"))


@pytest.mark.parametrize("call", ["open", "fsync", "replace", "unlink", "mkdir", "rmdir", "symlink"])
def test_errors_name_the_file_and_not_its_temporary_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    folder = Folder(tmp_path)
    steps: dict[str, Callable[[], object]] = {
        "unlink": lambda: folder.remove("it"),
        "mkdir": lambda: folder.make("it"),
        "rmdir": lambda: folder.remove_empty("it"),
        "symlink": lambda: folder.link("it", "there"),
    }

    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, "Input/output error", ".it.0123.tmp")

    step = steps.get(call, lambda: folder.write("it", b"new"))
    real = os.open
    broken = (
        (lambda path, flags, *a, **k: fail() if flags & os.O_CREAT else real(path, flags, *a, **k))
        if call == "open"
        else fail
    )
    monkeypatch.setattr(os, call, broken)
    with pytest.raises(OSError, match="Input/output error") as caught:
        step()
    assert str(caught.value) == f"[Errno 5] Input/output error: {str(tmp_path / 'it')!r}"


def test_a_taken_file_is_the_same_or_a_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "theirs").write_bytes(b"new")
    folder = Folder(tmp_path)
    for _ in range(2):
        folder.take("linked", tmp_path / "theirs")
        assert (tmp_path / "linked").samefile(tmp_path / "theirs")
    monkeypatch.setattr(os, "link", lambda *_, **__: (_ for _ in ()).throw(OSError()))
    folder.take("copied", tmp_path / "theirs")
    assert (tmp_path / "copied").read_bytes() == b"new"
    assert not (tmp_path / "copied").samefile(tmp_path / "theirs")
    assert sorted(os.listdir(tmp_path)) == ["copied", "linked", "theirs"]


def test_a_hard_link_is_not_appended_to_and_is_replaced_alone(tmp_path: Path, elsewhere: Path) -> None:
    os.link(elsewhere / "inner/thesis.tex", tmp_path / "it")
    for opened in (Folder.append, Folder.update):
        with pytest.raises(InputError, match="expected a file of one name"):
            opened(Folder(tmp_path), "it")
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


def test_reading_takes_the_room_of_the_file_not_of_the_bound(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"12345")
    tracemalloc.start()
    try:
        assert read_bounded(tmp_path / "file", 1 << 31) == b"12345"
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_a_file_that_does_not_tell_its_size_is_read_up_to_the_bound() -> None:
    told, size = Path("/proc/self/status").read_bytes(), Path("/proc/self/status").stat().st_size
    assert size == 0
    assert read_bounded(Path("/proc/self/status"), 1 << 20)[:40] == told[:40]
    with pytest.raises(FormatError, match="at most 100 bytes, got 101"):
        read_bounded(Path("/proc/self/status"), 100)
