"""`evaluate --format`: predictions for an export, of which the rates are known by hand."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from synth3dlanes.formats.export import Export

SCORED = ("apollo", "openlane", "once", "tusimple", "culane", "curvelanes")


@pytest.fixture(scope="module", params=SCORED)
def job(request, dataset, tmp_path_factory):
    job = Export(f"{dataset}/test", tmp_path_factory.mktemp("predicted") / request.param, request.param)
    job.write()
    return job


def ground(out, document):
    """Lines of OpenLane in its evaluator's frame, by its rules: camera to vehicle, then x right and y ahead."""
    pose = np.array(document["extrinsic"])
    for line in document["lane_lines"]:
        seen = np.array(line["visibility"]) > 0
        x, y, z = pose[:3, :3] @ np.array(line["xyz"])[:, seen] + [[0], [0], [pose[2, 3]]]
        yield {"xyz": np.column_stack([-y, x, z]).tolist(), "category": line["category"]}


def ground_truth(job, folder):
    """Predictions that are the ground truth, as each benchmark takes them: lists of lines by file, and a function that
    writes them; a line is moved by `aside`, metres or pixels."""
    out, name = job.out, job.format_name
    if name in ("apollo", "tusimple"):
        path = out / ("data_splits/standard/test.json" if name == "apollo" else "test_label.json")
        key = "laneLines" if name == "apollo" else "lanes"
        documents = [json.loads(line) for line in path.read_text().splitlines()]
        for document in documents if name == "apollo" else ():
            flags = document.pop("laneLines_visibility")
            lines = [np.array(line)[np.array(f) > 0] for line, f in zip(document[key], flags, strict=True)]
            document[key] = [line[np.abs(line[:, 0]) < 30].tolist() for line in lines]

        def write(predicted):
            for document, lines in zip(documents, predicted, strict=True):
                document[key] = lines
                if name == "apollo":
                    document |= {"laneLines_prob": [1.0] * len(lines), "centerLines_prob": []}
                    document["centerLines"] = []
            folder.mkdir(exist_ok=True)
            text = "".join(json.dumps(document) + "\n" for document in documents)
            (folder / "predictions.json").write_text(text)
            return folder / "predictions.json"

        return [document[key] for document in documents], write
    patterns = {
        "openlane": "lane3d_1000/validation/seg*/*.json",
        "once": "ONCE_3DLanes/test/*/cam01/*.json",
        "culane": "driver_*/*.MP4/*.lines.txt",
        "curvelanes": "valid/labels/*.lines.json",
    }
    paths = sorted(out.glob(patterns[name]))
    root = {"openlane": out / "lane3d_1000", "once": out / "ONCE_3DLanes/test"}.get(name, out)

    def lines_of(path):
        text = path.read_text()
        if name == "culane":
            return [np.array(line.split(), dtype=float).reshape(-1, 2).tolist() for line in text.splitlines()]
        document = json.loads(text)
        if name == "curvelanes":
            return [[(float(p["x"]), float(p["y"])) for p in line] for line in document["Lines"]]
        return list(ground(out, document)) if name == "openlane" else document["lanes"]

    def text_of(lines):
        if name == "culane":
            return "".join(" ".join(f"{n}" for point in line for n in point) + "\n" for line in lines)
        if name == "curvelanes":
            return json.dumps({"Lines": [[{"x": str(x), "y": str(y)} for x, y in line] for line in lines]})
        if name == "openlane":
            return json.dumps({"lane_lines": lines})
        return json.dumps({"lanes": [{"points": line, "score": 0.9} for line in lines]})

    def write(predicted):
        for path, lines in zip(paths, predicted, strict=True):
            there = folder / path.relative_to(root)
            there.parent.mkdir(parents=True, exist_ok=True)
            there.write_text(text_of(lines))
        return folder

    return [lines_of(path) for path in paths], write


def moved(line, name, aside):
    """A line of predictions a little or far aside."""
    if name == "tusimple":
        return [u + aside if u >= 0 else u for u in line]
    if name == "openlane":
        return {**line, "xyz": [[x + aside, y, z] for x, y, z in line["xyz"]]}
    return [[point[0] + aside, *point[1:]] for point in line]


def is_scored(line, name):
    """Whether OpenLane's evaluator, which samples every metre, looks at a line; the others' labels have no other."""
    if name != "openlane":
        return True
    x, y, _ = np.transpose(line["xyz"])
    kept = (np.abs(x) < 10) & (y > 0)
    samples = [at for at in range(3, 103) if kept.any() and y[kept][0] <= at <= y[kept][-1]]
    return np.count_nonzero(np.abs(np.interp(samples, y[kept], x[kept])) <= 10) > 1 if samples else False


def scored(job, path, *options):
    from cli.main import main

    command = ["evaluate", str(job.out), "--format", job.format_name, "--predictions", str(path), *options]
    return CliRunner().invoke(main, command)


def test_one_line_far_aside_is_missed_and_invented(job, tmp_path):
    """Two of all lines are moved: one by a pixel or 2 cm, which counts as found, and one to where no line is."""
    frames, write = ground_truth(job, tmp_path / "all")
    near, far = (1, 2000) if job.format_name in ("tusimple", "culane", "curvelanes") else (0.02, 40.0)
    perfect = json.loads(scored(job, write(frames), "--json").stdout)
    n_lines = sum(is_scored(line, job.format_name) for lines in frames for line in lines)
    assert n_lines > 8
    moved_frames = [list(lines) for lines in frames]
    first = next(i for i, lines in enumerate(frames) if len(lines) > 1)
    moved_frames[first][0] = moved(frames[first][0], job.format_name, near)
    moved_frames[first][1] = moved(frames[first][1], job.format_name, far)
    found = json.loads(scored(job, write(moved_frames), "--json").stdout)
    for one, other in zip(perfect, found, strict=True):
        before, after = one["rates"], other["rates"]
        assert one["frames"] == other["frames"] > 0
        if job.format_name == "tusimple":
            assert (before["accuracy"], before["false_positive"], before["false_negative"]) == (1, 0, 0)
            n, most = len(frames[first]), min(len(frames[first]), 4)
            forgiven = len(frames[first]) > 4
            assert after["false_positive"] == pytest.approx(1 / n / one["frames"])
            assert after["false_negative"] == pytest.approx((1 - forgiven) / most / one["frames"])
            continue
        assert (before["recall"], before["precision"]) == (1, 1), one["name"]
        if one["frames"] < len(frames):
            continue  # OpenLane's lists of cases have some of the frames
        assert after["recall"] == pytest.approx((n_lines - 1) / n_lines)
        # OpenLane's evaluator drops predictions that are nowhere within 10 m beside the camera's axis.
        n_found = 0 if job.format_name == "openlane" else 1
        assert after["precision"] == pytest.approx((n_lines - n_found) / n_lines)
        assert after["f_score"] < before["f_score"]


def test_what_is_said_of_predictions_that_cannot_be_scored(job, tmp_path):
    frames, write = ground_truth(job, tmp_path / "some")
    text = scored(job, write(frames)).output
    assert "4 frames" in text
    assert "1.0000" in text
    (tmp_path / "none").mkdir()
    (tmp_path / "none.json").write_text("")
    path = tmp_path / ("none.json" if job.format_name in ("apollo", "tusimple") else "none")
    refused = scored(job, path)
    assert refused.exit_code == 2
    assert refused.output.count("\n") == 1
    assert f"{path}: expected predictions for the frames of {job.out}, got none" in refused.output
    path = write(frames)
    if path.is_dir():
        next(file for file in path.rglob("*") if file.is_file()).unlink()
    else:
        path.write_text("".join(line + "\n" for line in path.read_text().splitlines()[1:]))
    refused = scored(job, path)
    assert refused.exit_code == 2
    assert "expected predictions for the " in refused.output
    assert ", none for " in refused.output


def test_formats_without_a_benchmark_are_refused(dataset, tmp_path):
    from cli.main import main

    def run(*options):
        return CliRunner().invoke(main, ["evaluate", str(tmp_path), "--format", "opendrive", *options])

    refused = run("--predictions", str(tmp_path))
    assert "--format: expected a format with a benchmark that can be scored here, got opendrive" in refused.output
    assert "--format needs --predictions" in run().output
    assert "--threshold has no effect with --format" in run("--predictions", str(tmp_path), "--threshold", "0.3").output
