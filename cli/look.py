"""`synth3dlanes inspect`, `gallery` and `report`: figures of scenes and data sets."""

import json
from pathlib import Path

import click

from synth3dlanes.scene.settings import PASSES
from synth3dlanes.system.files import encoded, write
from synth3dlanes.system.words import counted

from .options import CountRange, OutputFile, json_option, output_console, refuse_idle


@click.command()
@click.argument("where", metavar="SCENE.JSON|DIR/SPLIT:KEY")
@click.option("--image", type=click.Path(path_type=Path), help="The rendered image of SCENE.JSON.")
@click.option(
    "--out",
    type=OutputFile(".png", ".svg", ".pdf"),
    help="Figure to write.  [default: NAME.inspect.png in the current folder]",
)
@click.option(
    "--html",
    type=OutputFile(".html"),
    help="Write an HTML page with masks and an interactive 3D view instead of a figure.",
)
@click.option(
    "--rerun",
    type=OutputFile(".rrd"),
    help="Write a recording of the sample's whole clip and rig for the viewer of rerun.io instead of a figure.",
)
@click.option("--passes", is_flag=True, help="Also show the passes: depth, normals, ids, heights.")
@json_option
def inspect(
    where: str,
    image: Path | None,
    out: Path | None,
    html: Path | None,
    rerun: Path | None,
    passes: bool,
    as_json: bool,
) -> None:
    """Print a summary of one scene and draw its image, top view, side view and 3D view.

    The scene is a scene.json, rendered or not, or a sample of a data set such as DIR/train:00000017.
    """
    from synth3dlanes.dataset.columns import numbers_of
    from synth3dlanes.figures.describe import scene_document
    from synth3dlanes.figures.inspect import draw_inspect, summary
    from synth3dlanes.figures.page import scene_page
    from synth3dlanes.figures.samples import load_shown

    refuse_idle(not rerun or html is not None or out is not None, ["passes"], "with --rerun alone, which has none")
    shown = load_shown(where, image, with_passes=passes, with_clip=html is not None)
    written = {}
    if html:
        write(html, scene_page(shown).encode())
        written["page"] = str(html)
    if rerun:
        from synth3dlanes.figures.recording import sample_recording

        write(rerun, sample_recording(where))
        written["recording"] = str(rerun)
    if out or not (html or rerun):
        path = out or Path(f"{shown.name}.inspect.png")
        figure = draw_inspect(shown)
        write(path, encoded(lambda stream: figure.savefig(stream, format=path.suffix[1:], dpi=100)))
        written["figure"] = str(path)
    if as_json:
        columns = numbers_of(shown.scene, shown.labels)
        click.echo(json.dumps({**written, "columns": columns, **scene_document(shown)}))
        return
    output_console().print(summary(shown))
    for what, name in written.items():
        click.echo(f"{what.capitalize()}: {name}")


@click.command()
@click.argument("folder", metavar="DIR")
@click.option("--out", type=OutputFile(".png", ".jpg"), default="gallery.png", help="Image to write.")
@click.option("--n", type=CountRange(min=1), default=24, help="Maximum number of samples.")
@click.option("--columns", type=click.IntRange(min=1), default=6, help="Number of columns.")
@click.option(
    "--shuffle",
    metavar="SEED",
    type=click.IntRange(min=0),
    help="Show random samples, chosen with this seed, instead of the first.",
)
@click.option("--lanes/--no-lanes", default=True, help="Draw the labels on the images.")
@click.option(
    "--show", type=click.Choice(["image", *PASSES]), default="image", help="Show the images, or one of the passes."
)
@click.option("--where", metavar="QUERY", help='Show only samples that match, such as "n_lanes = 4".')
@click.option("--width", metavar="PX", type=click.IntRange(min=100), help="Shrink the image to this width in pixels.")
def gallery(
    folder: str,
    out: Path,
    n: int,
    columns: int,
    shuffle: int | None,
    lanes: bool,
    show: str,
    where: str | None,
    width: int | None,
) -> None:
    """Draw many samples of one split (DIR/train), or of the first split of a data set (DIR), in one image, each with
    its key.

    --where selects samples by the columns of the index (docs/format.md): --where "flip_lateral and n_lanes = 4" or
    --where "junction = 'merge' and max_grade > 0.1".
    """
    from synth3dlanes.dataset.scenes import some_samples
    from synth3dlanes.dataset.splits import split_name
    from synth3dlanes.figures.gallery import draw_gallery
    from synth3dlanes.figures.samples import shown_samples

    refuse_idle(show != "height", ["lanes"], "with --show height, which is no view of the camera")
    chosen = some_samples(folder, n, shuffle, where)
    samples = shown_samples(chosen, show, lanes)
    sheet = draw_gallery(samples, columns, width)
    kind = "PNG" if out.suffix.lower() == ".png" else "JPEG"
    write(out, encoded(lambda stream: sheet.save(stream, kind)))
    split = split_name(chosen[0][0])
    is_named = folder.rstrip("/").rpartition("/")[2] == split
    click.echo(f"Gallery: {out}" + ("" if is_named else f", {counted(len(samples), 'sample')} of {split}"))


@click.command()
@click.argument("where", metavar="DIR/SPLIT:KEY")
@click.option(
    "--out",
    type=OutputFile(".webp", ".gif", ".png"),
    default="clip.webp",
    help="Animated image to write: WebP, GIF or PNG.",
)
@click.option("--lanes/--no-lanes", default=True, help="Draw the labels on the frames.")
@click.option("--width", metavar="PX", type=click.IntRange(min=100), help="Shrink the frames to this width in pixels.")
def clip(where: str, out: Path, lanes: bool, width: int | None) -> None:
    """Write the clip to which a sample belongs, such as DIR/train:00000017, as an animated WebP, GIF or PNG."""
    from synth3dlanes.figures.gallery import draw_clip
    from synth3dlanes.figures.samples import load_clip

    found = load_clip(where)
    write(out, draw_clip(found.pictures(lanes), found.fps, width, out.suffix[1:].lower()))
    click.echo(f"Clip: {out}, {counted(len(found.frames), 'frame')}")


@click.command()
@click.argument("folder", metavar="DIR")
@click.option("--html", type=OutputFile(".html"), default="report.html", help="HTML page to write.")
@click.option(
    "--n",
    type=CountRange(min=1),
    default=2000,
    help="Maximum number of scenes to read for the statistics, evenly spaced.",
)
@click.option("--samples", metavar="K", type=click.IntRange(min=1), default=12, help="Number of samples to show.")
def report(folder: str, html: Path, n: int, samples: int) -> None:
    """Write an HTML page about a data set (DIR) or one split (DIR/train).

    Shows samples with lanes that can be switched on and off, the distributions of all parameters, and statistics of
    the labels. The page is a single file that loads nothing else.
    """
    from synth3dlanes.api import report_dataset

    report_dataset(folder, html, n=n, samples=samples)
    click.echo(f"Page: {html}")
