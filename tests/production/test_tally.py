"""What a run counts, logs and reports by its events, and what it says that it will take."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from synth3dlanes.dataset import stores
from synth3dlanes.dataset.destination import Destination
from synth3dlanes.production.forecast import forecast, patience_s, seconds_per_sample
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.production.tally import RunTally
from synth3dlanes.system.errors import OutageError
from tests import fake_samples


def told(asked: int = 10, missing: range = range(4, 10), log=None) -> tuple[RunTally, list]:
    events: list = []
    return RunTally(asked, missing, events.append, log), events


@pytest.mark.parametrize(
    ("tells", "counts", "expected"),
    [
        # A sample counts once, however often it is told of, and not if it was there before.
        ([("sample", 4), ("sample", 5), ("sample", 5), ("sample", 2)], [(5, 0), (6, 0), (6, 0), (6, 0)], {"made": 3}),
        # A lost one is missing until it is made again.
        ([("sample", 4), ("lost", 4), ("sample", 4)], [(5, 0), (4, 0), (5, 0)], {"made": 1, "done": 5}),
        # Those set aside fail the run, unless they are made after all.
        (
            [(kind, index) for index in (7, 8) for kind in ("restart", "set_aside")] + [("sample", 7)],
            [(4, 0), (4, 1), (4, 1), (4, 2), (5, 1)],
            {"set_aside": (8,), "restarts": 2, "exit_code": 1},
        ),
        # A recount goes by what is there.
        ([("sample", 4), ("missing", [8, 9])], [(5, 0)], {"made": 4, "done": 8, "exit_code": 0}),
    ],
)
def test_what_is_counted(tells, counts, expected):
    tally, events = told()
    for kind, index in tells:
        if kind == "lost":
            tally.tell("shard", "", shard=0, lost=[index])
        elif kind == "missing":
            tally.recount(index)
        else:
            tally.tell(kind, "", index=index)
    assert [(event.done, event.set_aside) for event in events] == counts
    assert {name: getattr(tally.report(), name) for name in expected} == expected


def test_exit_codes_and_stopping():
    tally, _ = told()
    assert (tally.is_stopping, tally.report().exit_code) == (False, 0)
    tally.interrupt()
    assert (tally.is_stopping, tally.report().exit_code) == (True, 130)
    tally.problem = "no room"
    assert tally.report().exit_code == 1


def test_a_log_that_cannot_be_saved_is_one_line_at_the_end(tmp_path, monkeypatch):
    def refuse(*_):
        raise OutageError("store: gone")

    monkeypatch.setattr(stores, "put", refuse)
    with Destination((tmp_path / "store").as_uri()).log("run.jsonl") as log:
        tally, events = told(log=log)
        for kind in ("start", "shard", "shard", "end"):
            tally.tell(kind, "", lost=())
    assert tally.problem == ""
    assert [event.kind for event in events] == ["start", "shard", "shard", "end", "pause"]
    found = re.fullmatch("the log is not in the store: store: gone; the log is (.*)", events[-1].message)
    assert [json.loads(line)["kind"] for line in Path(found[1]).read_text().splitlines()][-1] == "end"
    monkeypatch.undo()
    # The next run takes it along as it ends.
    with Destination((tmp_path / "store").as_uri()).log("next.jsonl") as log:
        tally, events = told(log=log)
        tally.tell("end", "")
    assert [event.kind for event in events] == ["end"]
    assert not Path(found[1]).exists()
    logs = {path.name: path.read_text().splitlines() for path in (tmp_path / "store/logs").iterdir()}
    assert logs.keys() == {"run.jsonl", "next.jsonl"}
    assert [json.loads(line)["kind"] for line in logs["run.jsonl"]] == ["start", "shard", "shard", "end"]


LARGE = ("camera.width_px=7680", "camera.height_px=4320")


def test_large_images_may_take_longer():
    small, large = (fake_samples.recipe(overrides=changes) for changes in ((), LARGE))
    assert patience_s(small) == 120
    assert seconds_per_sample(large) > 80, "8K with 4 samples per pixel, at a second for 480x360"
    assert patience_s(large) > 20 * seconds_per_sample(large)


def test_the_time_has_blenders_start_once_and_falls_with_workers():
    recipe = fake_samples.recipe()
    seconds = {n: forecast(recipe, n, 1).seconds for n in (0, 1, 2, 102)}
    per_image = (seconds[102] - seconds[2]) / 100
    start = seconds[1] - per_image
    assert seconds[0] == 0
    assert 1 < start < 10, "importing bpy and loading the first scene takes seconds"
    assert abs(seconds[2] - (start + 2 * per_image)) < 1e-9
    assert abs(forecast(recipe, 102, 2).seconds - (start + 51 * per_image)) < 1e-9


def test_a_forecast_follows_what_the_last_run_measured(tmp_path: Path) -> None:
    """By its log, whatever is odd in that."""
    recipe = fake_samples.recipe()
    plan = Plan(tmp_path / "d", 8, recipe, workers=2, maker=fake_samples.make_slowly)
    assert not plan.expected().is_measured
    generate(plan, lambda event: None)
    more = replace(plan, n=1008).expected()
    assert more.is_measured
    assert "as the samples before took" in more.text()
    assert more.samples == 1000
    assert 0.15 < (more.seconds - 3) * 2 / 1000 < 1.5, "what make_slowly takes, far from what rendering takes"
    sizes = [path.stat().st_size for path in (tmp_path / "d/train").glob("*.tar")]
    assert 0.5 < more.bytes_kept / 1000 / (sum(sizes) / 8) < 1.5
    (log,) = (tmp_path / "d/logs").glob("train-*.jsonl")
    whole = log.read_text()
    log.write_text(whole + '{"kind": "sample", "details": {"seconds": "x"}}\n{"kind"\n[1]\n')
    assert replace(plan, n=1008).expected() == more
    log.write_text("".join(line for line in whole.splitlines(True) if '"sample"' not in line))
    assert not replace(plan, n=1008).expected().is_measured
    assert (
        not Plan(tmp_path / "d", 8, replace(recipe, scenes=replace(recipe.scenes, split="val"))).expected().is_measured
    )
