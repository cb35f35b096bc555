"""Every kind of run counts, logs and reports by its events."""

import json
import re
from pathlib import Path

from synth3dlanes.dataset import stores
from synth3dlanes.dataset.destination import Destination
from synth3dlanes.production.tally import RunTally
from synth3dlanes.system.errors import OutageError


def told(asked: int = 10, missing: range = range(4, 10), log=None) -> tuple[RunTally, list]:
    events: list = []
    return RunTally(asked, missing, events.append, log), events


def test_samples_count_once_however_often_they_are_told_of():
    tally, events = told()
    for index in (4, 5, 5, 2):
        tally.tell("sample", "", index=index)
    assert [event.done for event in events] == [5, 6, 6, 6]
    assert tally.report().made == 3


def test_a_lost_sample_is_missing_until_it_is_made_again():
    tally, events = told()
    tally.tell("sample", "", index=4)
    tally.tell("shard", "", shard=0, lost=[4])
    assert [event.done for event in events] == [5, 4]
    tally.tell("sample", "", index=4)
    assert (tally.report().made, tally.report().done) == (1, 5)


def test_set_aside_samples_fail_the_run_unless_they_are_made_after_all():
    tally, events = told()
    for index in (7, 8):
        tally.tell("restart", "", index=index)
        tally.tell("set_aside", "", index=index)
    tally.tell("sample", "", index=7)
    report = tally.report()
    assert (report.set_aside, report.restarts, report.exit_code) == ((8,), 2, 1)
    assert [event.set_aside for event in events] == [0, 1, 1, 2, 1]


def test_exit_codes_and_stopping():
    tally, _ = told()
    assert (tally.is_stopping, tally.report().exit_code) == (False, 0)
    tally.interrupt()
    assert (tally.is_stopping, tally.report().exit_code) == (True, 130)
    tally.problem = "no room"
    assert tally.report().exit_code == 1


def test_a_recount_goes_by_what_is_there():
    tally, _ = told()
    tally.tell("sample", "", index=4)
    tally.recount([8, 9])
    assert (tally.report().made, tally.report().done) == (4, 8)


def test_the_log_holds_every_event_also_that_of_a_store(tmp_path):
    for name, place in (("here", tmp_path / "here"), ("store", (tmp_path / "store").as_uri())):
        (tmp_path / name).mkdir()
        with Destination(place).log("run.jsonl") as log:
            tally, events = told(log=log)
            tally.tell("start", "")
            tally.tell("sample", "", index=4)
            tally.tell("end", "complete")
        lines = (tmp_path / name / "logs" / "run.jsonl").read_text().splitlines()
        assert [json.loads(line)["kind"] for line in lines] == [event.kind for event in events]


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
    # The next run's last save takes it along.
    with Destination((tmp_path / "store").as_uri()).log("next.jsonl") as log:
        assert log.save(is_last=True) == ""
    assert {path.name for path in (tmp_path / "store/logs").iterdir()} == {"run.jsonl", "next.jsonl"}
