"""`synth3dlanes generate`: many labelled scenes into shards."""
import click
@click.command()
def generate() -> None:
    """."""
