"""Where `synth3dlanes` starts: Ctrl-C ends it in one line even while its commands are still being imported."""

import signal
import sys


def run() -> None:
    """Import the commands and run the one that is asked for."""
    try:
        from .main import run as start
    except KeyboardInterrupt:
        sys.stderr.write("synth3dlanes: interrupted\n")
        sys.exit(128 + signal.SIGINT)
    start()
