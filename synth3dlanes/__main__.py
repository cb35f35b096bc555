"""`python -m synth3dlanes`: the command line."""

from synth3dlanes_cli.entry import run

if __name__ == "__main__":
    run()
