"""What goes wrong, by name. The message says where and, for a value, what was expected and what was found.

A function names its own arguments ("workers: expected 0 or more, got -1"); which flag gave a value, `cli` knows.

Exception
 +-- Synth3dlanesError       all of ours
      +-- InputError           an argument, a parameter file or an override is wrong; a ValueError
      |    +-- ClaimedError      another run holds the lock on a shard
      |    +-- DrawError             a scene cannot be drawn from its parameters
      |    +-- LinkError         a link lies where something is to be written
      +-- FormatError          a file does not follow its format, or a store refuses to give it; a ValueError
      +-- OutageError          a store or a cluster cannot be reached; running again later helps
      +-- DiskFullError        there is too little room for what is to be written
      +-- MissingPackageError  a package that this function needs is not installed or cannot be imported
      +-- WorkerError          a worker process crashed, hung or was killed
"""

import errno

# What a disk, a network or the limits of a process do to any call: the same command may well succeed later.
ENVIRONMENT = {
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.EBUSY, errno.ETXTBSY, errno.ENODEV),
    *(errno.ENXIO, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN, errno.ENOLCK, errno.ESTALE, errno.ENOTCONN),
    *(errno.ETIMEDOUT, errno.ENETDOWN, errno.ENETUNREACH, errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.ECONNRESET),
    getattr(errno, "EREMOTEIO", errno.EIO),
}


class Synth3dlanesError(Exception):
    """Every error that this library raises on purpose."""


class InputError(Synth3dlanesError, ValueError):
    """One or more wrong values; `problems` holds one line each."""

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class ClaimedError(InputError):
    """Another run holds the lock on a shard."""


class DrawError(InputError):
    """A scene cannot be drawn from its parameters; no other try changes that."""


class LinkError(InputError):
    """A link lies where something is to be written, below the folder that was named: who put it there is not known."""


class FormatError(Synth3dlanesError, ValueError):
    """A file that does not follow its format; the message names the place."""


class OutageError(Synth3dlanesError):
    """A store or a cluster cannot be reached; running again later helps. The message names it."""


class DiskFullError(Synth3dlanesError):
    """There is too little room on a disk; the message names the disk, what is needed and what is free."""


class MissingPackageError(Synth3dlanesError):
    """A package is not installed or cannot be imported; the message says what to install."""


class WorkerError(Synth3dlanesError):
    """A worker process ended without a result; the message has its last words."""


def how_to_install(extra: str) -> str:
    """What installs an extra: from the source, as no package index has this project yet."""
    return f"pip install '.[{extra}]' in the folder of its source"


def is_of_environment(error: BaseException | None) -> bool:
    """Whether an error, or an error that caused it, came from the environment and not from the user's input."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in ENVIRONMENT:
            return True
        error = error.__cause__ or error.__context__
    return False


def told(error: BaseException) -> str:
    """What went wrong, for people: of an error of the system the file and the reason, of others their type too."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return f"{type(error).__name__}: {error}"
