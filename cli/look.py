"""`synth3dlanes inspect` and `gallery`: pictures for people."""

import json
from pathlib import Path

import click

from .options import json_option


@click.command()
@click.argument("where", metavar="SCENE.JSON|DIR/SPLIT:KEY")
@click.option("--image", type=click.Path(path_type=Path), help="The rendered image of SCENE.JSON.")
@click.option("--out", type=click.Path(path_type=Path), help="The figure to write.  [default: NAME.inspect.png, here]")
@json_option
def inspect(where: str, image: Path | None, out: Path | None, as_json: bool) -> None:
    """Explain one scene: a summary, and a figure of image, top view, side view and 3D.

    Takes a scene.json, rendered or not, or a sample of a data set such as DIR/train:00000017.
    """
    import rich

    from synth3dlanes.figures.describe import describe
    from synth3dlanes.figures.inspect import draw_inspect, summary
    from synth3dlanes.look_up import load_any

    found = load_any(where, image)
    path = out or Path(f"{found.name}.inspect.png")
    draw_inspect(found.scene, found.labels, found.image).savefig(path, dpi=100)
    if as_json:
        click.echo(json.dumps({"figure": str(path), **describe(found.scene, found.labels)}))
        return
    rich.print(summary(found.scene, found.labels))
    click.echo(f"Figure: {path}")


@click.command()
@click.argument("folder", metavar="DIR")
@click.option("--out", type=click.Path(path_type=Path), default="gallery.png", help="The picture to write.")
@click.option("--n", type=click.IntRange(min=1), default=24, help="At most this many samples.")
@click.option("--columns", type=click.IntRange(min=1), default=6)
@click.option("--shuffle", metavar="SEED", type=click.IntRange(min=0), help="Random samples instead of the first.")
@click.option("--lanes/--no-lanes", default=True, help="Draw the labels on the images.")
def gallery(folder: str, out: Path, n: int, columns: int, shuffle: int | None, lanes: bool) -> None:
    """Many samples of a data set (DIR) or of one split (DIR/train) on one sheet."""
    from synth3dlanes.figures.gallery import draw_gallery
    from synth3dlanes.look_up import some_samples

    samples = some_samples(folder, n, shuffle)
    labels = [sample.labels for sample in samples] if lanes else None
    draw_gallery([sample.image for sample in samples], labels, columns).save(out)
    click.echo(f"Gallery: {out}")
