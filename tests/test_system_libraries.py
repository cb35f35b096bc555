"""A library of the system that Blender misses is told with the line that installs it."""

import subprocess
import sys
from pathlib import Path

import pytest

from synth3dlanes.production.workers import Limits, call
from synth3dlanes.system import system_libraries
from synth3dlanes.system.errors import WorkerError
from synth3dlanes.system.system_libraries import PACKAGES, install_hint, missing_packages

ROOT = Path(__file__).parents[1]
NO_LIBRARY = "libXrender.so.1: cannot open shared object file: No such file or directory"


def import_without_library() -> None:
    raise ImportError(NO_LIBRARY)


def test_a_worker_that_misses_a_library_says_what_to_install() -> None:
    expected = (
        r"^Blender: ImportError: libXrender\.so\.1: cannot open .*; install it: sudo apt-get install -y libxrender1"
    )
    with pytest.raises(WorkerError, match=expected):
        call(Limits(), import_without_library).result("Blender")


def test_all_that_is_missing_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system_libraries, "_is_missing", lambda library: library in ("libXi.so.6", "libGL.so.1"))
    assert missing_packages() == ["libxi6", "libgl1"]
    assert install_hint(NO_LIBRARY) == "; install it: sudo apt-get install -y libxrender1 libxi6 libgl1"
    assert install_hint("libfoo.so.3: cannot open shared object file") == (
        "; install the package of your system that has it"
    )
    assert install_hint("No module named 'bpy'") == ""
    for library, package in PACKAGES.items():
        assert install_hint(f"{library}: cannot open shared object file").startswith(
            f"; install it: sudo apt-get install -y {package} "
        )


def test_setup_asks_it_before_anything_is_installed() -> None:
    command = [sys.executable, "-P", "-S", str(ROOT / "synth3dlanes" / "system" / "system_libraries.py")]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    assert told.split() == missing_packages()
    assert "synth3dlanes/system/system_libraries.py" in (ROOT / "scripts" / "setup").read_text()
