"""`python -m synth3dlanes`: the command line."""

from synth3dlanes_cli.entry import run

# Worker processes that draw scenes import this module too.
if __name__ == "__main__":
    run()
