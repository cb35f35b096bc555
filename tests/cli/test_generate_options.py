"""What `generate` makes of its options, and what it prints while it works."""

import pytest
from synth3dlanes_cli.generate import generate, progress
from synth3dlanes_cli.main import main
from synth3dlanes_cli.options import given

from synth3dlanes.production.events import LEVEL_OF, Event, duration
from synth3dlanes.production.job import Job


@pytest.mark.parametrize(
    ("options", "samples"),
    [
        ((), 4),
        (("--quality", "draft"), 2),
        (("--quality", "high"), 8),
        (("--samples", "7"), 7),
    ],
)
def test_quality_is_a_name_for_a_number_of_samples(options, samples):
    with generate.make_context("generate", ["--n", "1", *options], **main.context_settings) as context:
        assert Job(**given(context.params)).settings.samples == samples


@pytest.mark.parametrize(
    ("level", "expected"),
    [
        ("debug", ["sample", "shard", "start", "resume", "restart", "pause", "stop", "set_aside"]),
        ("info", ["start", "resume", "restart", "pause", "stop", "set_aside"]),
        ("warning", ["restart", "pause", "stop", "set_aside"]),
        ("error", ["set_aside"]),
    ],
)
def test_the_log_level_decides_what_is_printed(level, expected, capsys):
    with progress(level) as notify:
        for kind in LEVEL_OF:
            notify(Event(kind, f"<{kind}>", 1, 2, 0, 1.0, 1.0, 1.0, {}))
    printed = capsys.readouterr().err
    assert [kind for kind in LEVEL_OF if f"<{kind}>" in printed] == expected
    assert "1/2  3,600 images/h, 0:00:01 left" in printed


def test_durations_are_read_as_clocks():
    assert [duration(seconds) for seconds in (0.4, 65, 3725.6)] == ["0:00:00", "0:01:05", "1:02:06"]
