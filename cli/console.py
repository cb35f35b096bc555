"""Tables and text as wide as the terminal, or of any width where the output is no terminal."""

from rich.console import Console

# Wider than any table; tables are as wide as their content.
NO_LIMIT = 10_000


class OutputConsole(Console):
    """Standard output, or standard error, at the width of its terminal or at full width; Ctrl-C and closed pipes are
    left to the command line."""

    def __init__(self, *, stderr: bool = False, soft_wrap: bool = False) -> None:
        super().__init__(stderr=stderr, soft_wrap=soft_wrap)
        if not self.is_terminal:
            self.width = NO_LIMIT

    def on_broken_pipe(self) -> None:
        """Leave a closed pipe to the group of all commands."""
        raise BrokenPipeError
