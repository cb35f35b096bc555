"""Recipes in the documentation make whole scenes."""

import re
from pathlib import Path

import pytest

from synth3dlanes.params.rig_files import load_rig

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
RECIPES = [(page.name, line) for page in PAGES for line in page.read_text().splitlines()
           if line.startswith("synth3dlanes generate") and "--rig" in line]  # fmt: skip


def option(line: str, name: str) -> str | None:
    found = re.search(rf"--{name} (\S+)", line)
    return found and found[1]


@pytest.mark.parametrize(("page", "line"), RECIPES)
def test_a_recipe_with_a_ready_rig_makes_all_pictures_of_its_scenes(page: str, line: str) -> None:
    rig, n = option(line, "rig"), option(line, "n")
    if rig is None or n is None or not (ROOT / f"params/rigs/{rig}.yaml").exists():
        return
    assert int(n) % (len(load_rig(rig)) * int(option(line, "frames") or 1)) == 0, page
