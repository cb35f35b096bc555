"""Files that may not grow: as on a disk that is nearly full, a write takes a part, and the next one fails."""

import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from click.testing import Result

from tests.power_cut import contents


@contextmanager
def small_files(n_bytes: int) -> Iterator[None]:
    """Let no file of this process grow beyond a size."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def withstands(run: Callable[[], Result], out: Path) -> None:
    """Assert that a command, which writes into the folder `out`, ends in a line that names a file where it cannot write
    all, with 1, and run again writes the same bytes as where nothing is in its way."""
    whole = run()
    assert whole.exit_code == 0, whole.output
    expected = contents(out)
    sizes = sorted({len(data) for data in expected.values()} - {0})
    for size in {sizes[-1] - 1, sizes[len(sizes) // 2] // 2}:
        shutil.rmtree(out)
        out.mkdir()
        with small_files(size):
            failed = run()
        if failed.exit_code == 0:  # it links files, and writes none
            assert contents(out) == expected
            continue
        assert failed.exit_code == 1, failed.output
        *_, line = failed.stderr.splitlines()
        place, _, reason = line.removeprefix("--out ").partition(": ")
        assert reason.endswith("File too large"), line
        assert out in (path := Path(place), *path.parents), line
        assert not path.name.endswith(".tmp")
        assert run().exit_code == 0
        assert contents(out) == expected
