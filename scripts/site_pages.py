"""Hooks of MkDocs (mkdocs.yml): the site has the pages of docs/, and what lies elsewhere in the repository.

Links between files of the repository become links between pages of the site, or lead to the repository.
"""

import json
import posixpath
import re
import tomllib
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import synth3dlanes
from synth3dlanes.formats.format import PinholeFormat, SampleFormat, format_names, open_format

ROOT = Path(__file__).parents[1]
# Pages of the site, by the files of the repository that they show.
ELSEWHERE = {
    "README.md": "index.md",
    "docs/README.md": "contents.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "examples/README.md": "examples.md",
    "examples/first_steps.ipynb": "notebook.md",
}
# The page of docstrings, and the folder with a page for each export format.
REFERENCE, FORMATS = "reference.md", "formats"
# The end of a link or picture, [words](target), with its words if these are plain.
LINK = re.compile(r"(\[[^\[\]]*)?\]\(([^)#\s]*)((?:#[^)\s]*)?)\)")
FENCED = re.compile(r"(^```.*?^```$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)


def repository() -> str:
    """The address of the repository."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return str(project["urls"]["Repository"])


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Take the order of pages from the index of docs/, and the address from the project."""
    config.extra["social"] = [{"icon": "fontawesome/brands/github", "link": repository(), "name": "Repository"}]
    config.nav = navigation((ROOT / "docs" / "README.md").read_text())
    return config


def navigation(index: str) -> list[dict[str, Any]]:
    """The groups and pages of an index, which has a heading and a table for each group."""
    groups: list[dict[str, Any]] = [{"Home": "index.md"}]
    for title, text in re.findall(r"^## (.+?)$(.*?)(?=^## |\Z)", index, re.MULTILINE | re.DOTALL):
        rows = re.findall(r"^\| \[(.+?)\]\((\S+?)\)", text, re.MULTILINE)
        groups.append({title: [{name: page_of(f"docs/{target}")} for name, target in rows]})
    pages = {title: page for group in groups for title, page in group.items()}
    pages["Reference"].append({"Docstrings": REFERENCE})
    pages["Data sets"].append({"Formats": [{name: f"{FORMATS}/{name}.md"} for name in format_names()]})
    groups.append({"All pages": page_of("docs/README.md")})
    return groups


def page_of(path: str) -> str:
    """The page of the site that shows a file of the repository; the file's own path where none does."""
    path = posixpath.normpath(path)
    return ELSEWHERE.get(path, path.removeprefix("docs/"))


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made of files outside docs/."""
    files.remove(files.get_file_from_path("README.md"))  # type: ignore[arg-type]
    for path, page in ELSEWHERE.items():
        text = (ROOT / path).read_text()
        files.append(File.generated(config, page, content=notebook(text) if path.endswith(".ipynb") else text))
    files.append(File.generated(config, REFERENCE, content=reference()))
    exports = (ROOT / "docs/exports.md").read_text()
    for name in format_names():
        files.append(File.generated(config, f"{FORMATS}/{name}.md", content=format_page(name, exports)))
    return files


def reference() -> str:
    """Every public name, from its docstring."""
    names = [name for name in synth3dlanes.__all__]
    kinds = {"Functions": [n for n in names if n[0].islower()], "Classes": [n for n in names if n[0].isupper()]}
    parts = ["# Reference", "All public names of `synth3dlanes`. [Python](api.md) explains them with examples."]
    for title, found in kinds.items():
        parts += [f"## {title}", *(f"::: synth3dlanes.{name}" for name in found)]
    return "\n\n".join(parts)


def format_page(name: str, exports: str) -> str:
    """What a format is, where its files lie, and what is in them; `exports` is the page of all formats."""
    found = open_format(name)
    listed = exports.partition("\n## Files\n")[2].partition("\n## ")[0]
    listed = listed.replace("](#", "](../exports.md#").replace("](exports_", "](../exports_")
    # Rows of one format follow each other; only the first names it.
    rows = re.search(rf"^\| `{name}` \|.*\n(?:\| \|.*\n)*", listed, re.MULTILINE)
    table = [f"|{row.split('|', 2)[2]}" for row in rows[0].splitlines()] if rows else []
    passes = found.passes if isinstance(found, SampleFormat) else ()
    facts = [f"- Passes that the data set must have: {', '.join(passes)}."] if passes else []
    if isinstance(found, PinholeFormat):
        camera = found.camera
        size = f"{camera.width_px}x{camera.height_px} px" + (", or any other `--size`" if found.is_size_free else "")
        facts.append(f"- Images of {size}, resampled to a pinhole of f = {camera.f_px:g} px.")
    limits = ", ".join(f"{limit:g} {unit}" for unit, limit in found.tolerances.items()) or "nothing"
    facts.append(f"- Read back, nothing is off by more than {limits}: `--verify` checks it.")
    facts += ["- `synth3dlanes evaluate --format` scores predictions by its benchmark."] if found.score else []
    return "\n".join(
        [
            f"# {name}\n\n{found.title}. [Exports](../exports.md) has what all formats share.\n",
            f"```sh\nsynth3dlanes export DIR --format {name} --out OUT --verify\n```\n",
            *facts,
            *(["\n| files | read by |", "|---|---|", *table] if table else []),
            f"\n## What an export says of itself\n\n{found.readme}",
        ]
    )


def notebook(text: str) -> str:
    """A notebook as a page."""
    cells = json.loads(text)["cells"]
    shown = ["".join(cell["source"]) if cell["cell_type"] == "markdown" else code(cell) for cell in cells]
    return "\n\n".join(shown)


def code(cell: dict[str, list[str]]) -> str:
    return f"```python\n{''.join(cell['source'])}\n```"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links between files of the repository into links of the site."""
    here = page.file.src_uri
    source = {shown: path for path, shown in ELSEWHERE.items()}.get(here, f"docs/{here}")
    titles = {target: title for group in config.nav or [] for title, target in pages_in(group)}

    def turned(found: re.Match[str]) -> str:
        words, target, anchor = found.groups()
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        if not target or "://" in target or not (ROOT / path).exists():
            return found[0]
        shown = page_of(path)
        if files.get_file_from_path(shown) is None:
            kind = "tree" if (ROOT / path).is_dir() else "blob"
            return f"{words or ''}]({repository()}/{kind}/main/{path}{anchor})"
        if (words or "").endswith(".md"):
            words = f"[{titles[shown]}"
        return f"{words or ''}]({posixpath.relpath(shown, posixpath.dirname(here) or '.')}{anchor})"

    parts = FENCED.split(markdown)
    return "".join(part if i % 2 else LINK.sub(turned, part) for i, part in enumerate(parts))


def pages_in(group: dict[str, Any]) -> list[tuple[str, str]]:
    """Title and page of all in a group of the navigation, however deep."""
    ((title, below),) = group.items()
    return [(title, below)] if isinstance(below, str) else [pair for page in below for pair in pages_in(page)]
