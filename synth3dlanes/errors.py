"""The two errors that a user can cause; the message says where, what was expected and what was found.

A function names its own arguments ("workers: expected 0 or more, got -1"); which flag gave a value, `cli` knows.

ValueError
 +-- InputError   a parameter file, an override or a command-line value is wrong
 +-- FormatError   bytes read from disk are not what their format says
"""


class InputError(ValueError):
    """One or more wrong parameters; `problems` holds one line each."""

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class FormatError(ValueError):
    """A file that does not follow its format; the message names the place."""
