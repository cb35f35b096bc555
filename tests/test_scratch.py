"""What killed processes leave in the temporary folder goes with the next one; what others use or own stays."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from synth3dlanes.system.scratch import OWNER, PREFIX, scratch

HOLDER = """
import sys
from synth3dlanes.system.scratch import scratch
with scratch() as folder:
    (folder / "texture.tif").write_bytes(bytes(1 << 20))
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def hold() -> tuple[subprocess.Popen[str], Path]:
    process = subprocess.Popen([sys.executable, "-c", HOLDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def test_only_folders_of_dead_processes_go(temporary: Path) -> None:
    documents = temporary / "documents"
    documents.mkdir()
    (documents / OWNER).touch()
    (documents / "thesis.tex").write_text("years of work")
    (temporary / f"{PREFIX}link").symlink_to(documents)
    (temporary / f"{PREFIX}unknown").mkdir()
    living, of_living = hold()
    dead, of_dead = hold()
    (of_dead / "link").symlink_to(documents)
    dead.kill()
    dead.communicate()
    with scratch() as mine:
        assert mine.is_dir()
        assert not of_dead.exists()
        assert (of_living / "texture.tif").exists()
    assert not mine.exists()
    living.communicate("")
    assert not of_living.exists()
    assert sorted(os.listdir(temporary)) == ["documents", f"{PREFIX}link", f"{PREFIX}unknown"]
    assert sorted(os.listdir(documents)) == [OWNER, "thesis.tex"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_folders_of_other_users_stay(temporary: Path) -> None:
    dead, of_dead = hold()
    dead.kill()
    dead.communicate()
    os.chown(of_dead, 4711, 4711)
    with scratch():
        assert of_dead.exists()


@pytest.mark.thorough
def test_a_killed_run_leaves_nothing_to_the_next(temporary: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """What its workers keep in the temporary folder is in the run's own."""
    out = tmp_path_factory.mktemp("out")
    command = [sys.executable, "-m", "tests.fake_samples", str(out), "12", "1"]
    killed = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert killed.stdout is not None
    assert next(line for line in killed.stdout if "kind='sample'" in line)
    killed.kill()
    killed.communicate()
    assert list(temporary.glob(f"{PREFIX}*"))
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    assert [name for name in os.listdir(temporary) if "-core-" not in name] == []
