"""The files of this machine as fsspec has them, but regular files alone, up to a bound."""

import os
from pathlib import Path
from typing import Any

from fsspec.implementations.local import LocalFileSystem

from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.files import open_regular
from synth3dlanes.system.schema import MAX_BYTES

# An index of 1,000,000 samples takes 600 MB, one sample of 8192 x 8192 pixels with all passes 1 GB.
MAX_READ_BYTES = 2 << 30
MOST_BYTES = {".json": MAX_BYTES, ".md": MAX_BYTES}


class LocalFiles(LocalFileSystem):  # type: ignore[misc]
    """Pipes and devices are refused, which would be waited for or read without end, and so is what is too large."""

    def cat_file(self, path: str, start: int | None = None, end: int | None = None, **named: Any) -> bytes:
        """The bytes from `start` to before `end`; raise FormatError for other kinds of files, and for too many."""
        place = Path(self._strip_protocol(path))
        most = MOST_BYTES.get(place.suffix, MAX_READ_BYTES)
        with open_regular(place) as stream:
            size = os.fstat(stream.fileno()).st_size
            first, last = slice(start, end).indices(size)[:2]
            if last - first > most:
                raise FormatError(f"{place}: expected at most {most:,} bytes, got {last - first:,}")
            stream.seek(first)
            return stream.read(max(0, last - first))

    def _open(self, path: str, mode: str = "rb", *arguments: Any, **named: Any) -> Any:
        if "r" in mode:
            open_regular(Path(path)).close()
        return super()._open(path, mode, *arguments, **named)
