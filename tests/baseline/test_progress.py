"""What a training tells where there is no terminal, as in a cluster's log."""

from synth3dlanes_baseline import progress


def test_a_log_file_gets_a_line_now_and_then_with_what_is_left(capsys, monkeypatch):
    clock = 0.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock)
    with progress.ProgressLine("step", 100, is_shown=True) as line:
        for step in range(1, 101):
            clock = step * 2.0
            line.update(step, 100, "8.0 samples/s")
    told = capsys.readouterr().err.splitlines()
    assert [text.split()[1] for text in told] == ["16/100", "32/100", "48/100", "64/100", "80/100", "96/100"]
    assert told[0] == "step 16/100  8.0 samples/s  0:02:48 left"


def test_other_processes_than_the_first_say_nothing(capsys, monkeypatch):
    monkeypatch.setattr(progress, "LINE_EVERY_S", -1.0)
    with progress.ProgressLine("step", 10, is_shown=False) as line:
        line.update(5, 10)
    assert capsys.readouterr().err == ""
