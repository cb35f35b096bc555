"""`python -m synth3dlanes`: the command line."""

from synth3dlanes_cli.entry import run

# Processes that many scenes are drawn in import this module too.
if __name__ == "__main__":
    run()
