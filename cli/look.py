"""`synth3dlanes inspect`, `gallery` and `report`: pictures for people."""

import json
from pathlib import Path

import click

from .options import json_option


@click.command()
@click.argument("where", metavar="SCENE.JSON|DIR/SPLIT:KEY")
@click.option("--image", type=click.Path(path_type=Path), help="The rendered image of SCENE.JSON.")
@click.option("--out", type=click.Path(path_type=Path), help="The figure to write.  [default: NAME.inspect.png, here]")
@click.option("--html", type=click.Path(path_type=Path), help="Write a page for a browser instead: masks, 3D to turn.")
@json_option
def inspect(where: str, image: Path | None, out: Path | None, html: Path | None, as_json: bool) -> None:
    """Explain one scene: a summary, and a figure of image, top view, side view and 3D.

    Takes a scene.json, rendered or not, or a sample of a data set such as DIR/train:00000017.
    """
    import rich

    from synth3dlanes.figures.describe import describe
    from synth3dlanes.figures.inspect import draw_inspect, summary
    from synth3dlanes.figures.page import scene_page
    from synth3dlanes.open_source import load_any

    found = load_any(where, image)
    written = {}
    if html:
        html.write_text(scene_page(found.scene, found.labels, found.image), encoding="utf-8")
        written["page"] = str(html)
    if out or not html:
        path = out or Path(f"{found.name}.inspect.png")
        draw_inspect(found.scene, found.labels, found.image).savefig(path, dpi=100)
        written["figure"] = str(path)
    if as_json:
        click.echo(json.dumps({**written, **describe(found.scene, found.labels)}))
        return
    rich.print(summary(found.scene, found.labels))
    for what, name in written.items():
        click.echo(f"{what.capitalize()}: {name}")


@click.command()
@click.argument("folder", metavar="DIR")
@click.option("--out", type=click.Path(path_type=Path), default="gallery.png", help="The picture to write.")
@click.option("--n", type=click.IntRange(min=1), default=24, help="At most this many samples.")
@click.option("--columns", type=click.IntRange(min=1), default=6, help="Samples beside each other.")
@click.option("--shuffle", metavar="SEED", type=click.IntRange(min=0), help="Random samples instead of the first.")
@click.option("--lanes/--no-lanes", default=True, help="Draw the labels on the images.")
@click.option("--where", metavar="QUERY", help="Only samples that fit, by the columns of the index.")
@click.option("--width", metavar="PX", type=click.IntRange(min=100), help="Shrink the sheet to this width.")
def gallery(
    folder: str, out: Path, n: int, columns: int, shuffle: int | None, lanes: bool, where: str | None, width: int | None
) -> None:
    """Many samples of a data set (DIR) or of one split (DIR/train) on one sheet.

    A query is like --where "flip_lateral and n_lanes = 4" or --where "junction = 'merge' and max_grade > 0.1".
    """
    from synth3dlanes.figures.gallery import draw_gallery
    from synth3dlanes.open_source import some_samples

    samples = some_samples(folder, n, shuffle, where)
    labels = [sample.labels for sample in samples] if lanes else None
    sheet = draw_gallery([sample.image for sample in samples], labels, columns)
    sheet.thumbnail((width or sheet.width, sheet.height))
    sheet.save(out)
    click.echo(f"Gallery: {out}")


@click.command()
@click.argument("folder", metavar="DIR")
@click.option("--html", type=click.Path(path_type=Path), default="report.html", help="The page to write.")
@click.option("--n", type=click.IntRange(min=1), default=2000, help="Scenes to read, evenly over the data set.")
@click.option("--samples", metavar="K", type=click.IntRange(min=1), default=12, help="Samples to show.")
def report(folder: str, html: Path, n: int, samples: int) -> None:
    """A page for a browser about a data set or one split: samples with lanes to switch, distributions, statistics.

    One file that loads nothing from anywhere.
    """
    from synth3dlanes.dataset.splits import readers, spread
    from synth3dlanes.figures.page import report_page
    from synth3dlanes.figures.stats import label_statistics, scene_statistics
    from synth3dlanes.open_source import params_of, read_scene

    found = readers(folder)
    places = spread(found, n)
    scenes = scene_statistics((read_scene(reader, i) for reader, i in places), params_of(found[0]))
    labels = label_statistics(reader.labels(i) for reader, i in places)
    shown = [
        (f"{reader.url}:{reader.key(i)}", reader.image(i), reader.labels(i)) for reader, i in spread(found, samples)
    ]
    html.write_text(report_page(folder, shown, scenes, labels), encoding="utf-8")
    click.echo(f"Page: {html}")
