"""From a checkpoint to files: predictions, pictures, reports, ONNX, flat ground; and from files to scores."""

import ast
import collections
import dataclasses
import inspect
import json
import subprocess
import sys

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from PIL import Image
from synth3dlanes_baseline import checkpoint as checkpoints
from synth3dlanes_baseline import onnx_decode, onnx_export
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.data import CameraImage, img_from_cam, intrinsics_of
from synth3dlanes_baseline.devices import choose_device
from synth3dlanes_baseline.evaluate import evaluate_checkpoint, evaluate_predictions, score, through_flat_ground
from synth3dlanes_baseline.inference import predictions_of
from synth3dlanes_baseline.lanes import read_predictions, write_predictions
from synth3dlanes_baseline.model import LaneNet, Output
from synth3dlanes_baseline.onnx_decode import decode
from synth3dlanes_baseline.onnx_export import OUTPUTS, export_onnx, exported, metadata_of, quantised
from synth3dlanes_baseline.overlay import _lines, save_pictures
from synth3dlanes_baseline.predict import PredictConfig, PredictionSummary, assumed_intrinsics, detector_for, predict
from synth3dlanes_baseline.report import save_plots, to_document, to_text
from synth3dlanes_baseline.statistics import describe_targets

from synth3dlanes.figures.colors import KINDS
from synth3dlanes.geometry.frames import project
from synth3dlanes.system.errors import FormatError, InputError
from tests.baseline import roads


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """An untrained tiny network: every path through the files is the same as a trained one's."""
    return _untrained(tmp_path_factory.mktemp("run") / "best.pt", "full")


def _untrained(path, row):
    torch.manual_seed(0)
    config = train_config("tiny", ablation=row)
    network = LaneNet(config.model)
    for name, value in network.named_parameters():  # those that begin at zero would hide the others
        if name.startswith(("refinements.", "close_look.")):
            torch.nn.init.normal_(value, std=0.05)
    checkpoints.save(path, checkpoints.Checkpoint(config, {}, network.state_dict(), None))
    return path


def detected(checkpoint, source, out, *intrinsics, **options) -> PredictionSummary:
    """What `predict` finds on the CPU."""
    return predict(detector_for(source, checkpoint, "cpu"), source, out, PredictConfig(*intrinsics, **options))


@pytest.fixture
def split(behind_splits):
    """A split of drawn pictures behind the name DIR/test."""
    return behind_splits(roads.samples(np.random.default_rng(4), 5, (160, 120)))


def test_without_a_checkpoint_photographs_get_the_weights_streets_and_splits_nano(split, tmp_path, monkeypatch):
    used, detector = [], checkpoints.detector
    monkeypatch.setattr(checkpoints, "detector", lambda file, *rest: used.append(file.stem) or detector(file, *rest))
    (tmp_path / "photographs").mkdir()
    Image.fromarray(split[0].image).save(tmp_path / "photographs/1.jpg")
    for source in (tmp_path / "photographs/1.jpg", tmp_path / "photographs", "DIR/test"):
        detected(None, source, tmp_path / "out", n_overlays=0)
    assert used == ["streets", "streets", "nano"]


def test_a_predictions_file_scores_as_the_checkpoint_does(checkpoint, split, tmp_path):
    path = detected(checkpoint, "DIR/test", tmp_path / "out", n_overlays=2).path
    from_file = to_document(evaluate_predictions(path, "DIR/test"))
    direct = to_document(evaluate_checkpoint(checkpoint, "DIR/test", device="cpu"))
    for kind in ("centerline", "delimiter"):
        assert from_file[kind]["ap"] == pytest.approx(direct[kind]["ap"], abs=0.02)
        assert from_file[kind]["n_detections"] == direct[kind]["n_detections"]
    assert from_file["pose"] == pytest.approx(direct["pose"], abs=1e-3)
    pictures = sorted((tmp_path / "out").glob("*.png"))
    assert len(pictures) == 2
    with Image.open(pictures[0]) as picture:
        assert picture.width > 600


def test_the_truth_written_as_predictions_reads_as_perfect(split, tmp_path):
    path = tmp_path / "p.jsonl"
    write_predictions(path, (roads.as_prediction(sample.labels, sample.key) for sample in split))
    report = evaluate_predictions(path, "DIR/test")
    document = json.loads(json.dumps(to_document(report), allow_nan=False))
    wanted = {"ap", "precision", "recall", "near_1sigma_cm", "near_2sigma_cm", "far_1sigma_cm", "far_2sigma_cm"}
    for kind in ("centerline", "delimiter"):
        assert wanted <= document[kind].keys()
        assert document[kind]["ap"] == pytest.approx(1.0)
        assert document[kind]["far_2sigma_cm"] < 0.2
    assert document["pose"] == pytest.approx({"pitch_median_deg": 0.0, "height_median_cm": 0.0}, abs=1e-4)
    assert "centerline" in to_text(report)
    save_plots(report, tmp_path / "plots.png")
    assert (tmp_path / "plots.png").stat().st_size > 10_000
    # Half of the lines missing counts as half of the images without detections.
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:2]) + "\n")
    assert evaluate_predictions(path, "DIR/test").kinds["centerline"].at_threshold.recall < 0.7


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ('{"key": "9", "lanes": []}', "expected keys such as '00000000', got '9'"),
        ('{"key": "00000000", "lanes": []}\n{"key": "00000000", "lanes": []}', "each key once"),
        (
            '{"key": "0", "lanes": [{"kind": "delimiter", "score": 1, "xyz_cam": [[0,1,2],[0,2,3]],'
            ' "visibility": [1]}]}',
            r"lanes\.0: visibility: expected 2 values, got 1",
        ),
        ('{"key": "0", "lanes": [{"kind": "delimiter", "score": NaN, "xyz_cam": [[0,1,2],[0,2,3]]}]}', "finite"),
    ],
)
def test_wrong_predictions_files_are_refused(split, tmp_path, line, problem):
    path = tmp_path / "p.jsonl"
    path.write_text(line + "\n")
    with pytest.raises(FormatError, match=problem):
        evaluate_predictions(path, "DIR/test")


def test_image_files_give_the_same_as_a_split(checkpoint, split, tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    for sample in split[:2]:
        Image.fromarray(sample.image).save(folder / f"{sample.key}.png")
    intrinsics = intrinsics_of(split[0].labels)
    of_files = detected(checkpoint, folder, tmp_path / "a", intrinsics, n_overlays=1)
    of_split = detected(checkpoint, "DIR/test", tmp_path / "b", n_overlays=0)
    assert (of_files.n_images, of_split.n_images) == (2, 5)
    pairs = list(zip(read_predictions(of_files.path), read_predictions(of_split.path), strict=False))
    assert len(pairs) == 2
    for mine, its in pairs:
        assert mine.key == its.key + ".png"
        assert len(mine.lanes) == len(its.lanes) > 0
        assert mine.lanes[0].xyz_cam == pytest.approx(its.lanes[0].xyz_cam, abs=2e-3)


def test_image_files_without_intrinsics_are_taken_for_those_of_the_papers_camera(checkpoint, split, tmp_path):
    Image.fromarray(split[0].image).save(tmp_path / "photo.jpg")
    fx, fy, cx, cy = assumed_intrinsics((120, 160))
    assert (cx, cy) == (80, 60)
    assert fx == fy == pytest.approx(80 * np.sqrt(3)), "30 degrees to each side"
    found = detected(checkpoint, tmp_path / "photo.jpg", tmp_path / "a")
    given = detected(checkpoint, tmp_path / "photo.jpg", tmp_path / "b", (fx, fy, cx, cy))
    assert found.path.read_bytes() == given.path.read_bytes()
    assert "60 degrees" in found.text()
    assert "60 degrees" not in given.text()
    Image.new("RGB", (3, 900)).save(tmp_path / "tall.png")
    with pytest.raises(InputError, match=r"^tall\.png: intrinsics: expected a centre"):
        detected(checkpoint, tmp_path / "tall.png", tmp_path / "c", (fx, fy, cx, cy))


def test_no_picture_replaces_an_image_or_another_picture(checkpoint, split, tmp_path):
    for name in ("road.jpg", "road.png"):
        Image.fromarray(split[0].image).save(tmp_path / name)
    before = (tmp_path / "road.png").read_bytes()
    with pytest.raises(InputError, match=r"out .*: expected a folder without road\.png"):
        detected(checkpoint, tmp_path, tmp_path)
    assert (tmp_path / "road.png").read_bytes() == before
    detected(checkpoint, tmp_path, tmp_path / "out")
    drawn = {f"{stem}{ending}" for stem in ("road", "road.png") for ending in (".png", ".overlay.jpg")}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"predictions.jsonl", *drawn}
    (tmp_path / "left_out.TIF").write_bytes(before)
    with pytest.raises(InputError, match=r"left_out\.TIF: expected images \(\.jpg, .* got 1 file of other kinds"):
        detected(checkpoint, tmp_path, tmp_path / "out")


def test_flat_ground_is_exact_on_a_plane_and_wrong_on_a_hill():
    flat = roads.labels([lambda y: (0.002 * y**2, 0 * y)])
    hill = roads.labels([lambda y: (0 * y + 3.0, 1e-4 * y**2)])
    for labels, low, high in ((flat, 0.0, 0.1), (hill, 5.0, np.inf)):
        projected = through_flat_ground(roads.as_prediction(labels), labels, "plane")
        errors = score([(labels, projected)]).kinds["centerline"].at_threshold
        assert low <= errors.far_2sigma_cm <= high


def test_a_damaged_image_to_quantise_by_is_told_before_the_export(checkpoint, tmp_path, monkeypatch):
    (tmp_path / "a.jpg").write_bytes(b"no image")
    monkeypatch.setattr(onnx_export, "exported", lambda _: pytest.fail("exported"))
    with pytest.raises(FormatError, match=r"a\.jpg: expected a JPEG"):
        export_onnx(checkpoint, tmp_path / "a.onnx", tmp_path)


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
def test_onnx_gives_equal_outputs(tmp_path):
    path = export_onnx(_untrained(tmp_path / "best.pt", "improved"), tmp_path / "m.onnx")
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    assert tuple(output.name for output in session.get_outputs()) == OUTPUTS
    model = checkpoints.build(checkpoints.load(tmp_path / "best.pt"), torch.device("cpu"))
    image = torch.rand(3, 3, 120, 160, generator=torch.Generator().manual_seed(0))
    intrinsics = torch.tensor([[138.6, 138.6, 80.0, 60.0]]).repeat(3, 1)
    values = session.run(list(OUTPUTS), {"image": image.numpy(), "intrinsics": intrinsics.numpy()})
    with torch.no_grad():
        output = model(image, intrinsics)
    x_m = output.x_m + model.anchors_m[:, None]
    expected = (x_m, output.z_m, output.logit.sigmoid(), output.pose, output.visible_logit.sigmoid())
    for value, wanted in zip(values, expected, strict=True):
        assert value == pytest.approx(wanted.numpy(), abs=1e-3)
    metadata = session.get_modelmeta().custom_metadata_map
    assert json.loads(metadata["config"])["has_visibility"] is True
    assert metadata == metadata_of(model.config)

    # In int8 are the convolutions alone; what they give is near.
    pictures = [CameraImage("0", (255 * image[0]).byte().permute(1, 2, 0).numpy(), (138.6, 138.6, 80.0, 60.0))]
    small = quantised(onnx.load(path), pictures, checkpoints.detector(tmp_path / "best.pt", torch.device("cpu")))
    by_kind = collections.Counter(node.op_type for node in small.graph.node)
    weights = {one.name: one.data_type for one in small.graph.initializer}
    n_int8 = sum(kind == onnx.TensorProto.INT8 and name.endswith("_quantized") for name, kind in weights.items())
    assert n_int8 == by_kind["Conv"] > 20
    session = onnxruntime.InferenceSession(small.SerializeToString(), providers=["CPUExecutionProvider"])
    again = session.run(list(OUTPUTS), {"image": image.numpy(), "intrinsics": intrinsics.numpy()})
    off = [np.abs(a - b).mean() / np.abs(b).mean() for a, b in zip(again, values, strict=True)]
    assert 0 < max(off) < 0.1


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("row", ["image_view", "fixed_position"])
def test_an_onnx_file_takes_any_number_of_images(row):
    proto = exported(LaneNet(train_config("tiny", ablation=row).model).eval())
    for value in (*proto.graph.input, *proto.graph.output):
        assert value.type.tensor_type.shape.dim[0].dim_param == "batch", value.name


@pytest.mark.parametrize("row", ["full", "improved"])
def test_the_decoder_of_onnx_outputs_gives_the_lanes_of_predict(row):
    from synth3dlanes_baseline.onnx_export import plain

    model = LaneNet(train_config("tiny", ablation=row).model)
    has_visibility = row == "improved"
    rng = np.random.default_rng(3)
    shape = (3, 3, 16, len(model.config.knots_y_m))
    pose = torch.tensor([[0.02, 1.5], [-0.01, 1.6], [0.09, 1.9]], dtype=torch.float64)
    x_m, z_m, logit, visible_logit = (torch.from_numpy(rng.normal(0, 3, s)) for s in (shape, shape, shape[:3], shape))
    logit = logit.round()  # some neighbours are equal
    output = Output(x_m, z_m, logit, visible_logit if has_visibility else None, pose, torch.eye(4).repeat(3, 1, 1))
    arrays = [value.numpy() for value in plain(model, output)]
    outputs = dict(zip(OUTPUTS, arrays, strict=False))
    assert ("visibility" in outputs) == has_visibility
    metadata = metadata_of(model.config)
    by_torch = [prediction.lanes for prediction in predictions_of("abc", output, model.config)]
    for lanes, found in zip(by_torch, decode(outputs, metadata), strict=True):
        assert len(lanes) == len(found) > 10
        for lane, mine in zip(lanes, found, strict=True):
            assert (mine["kind"], mine["score"]) == (lane.kind, pytest.approx(lane.score))
            assert mine["xyz_cam"] == pytest.approx(lane.xyz_cam, abs=1e-5)
            assert ("visibility" in mine) == (lane.visibility is not None) == has_visibility
            if has_visibility:
                assert mine["visibility"] == pytest.approx(lane.visibility)
    with pytest.raises(ValueError, match="expected natural, got pchip"):
        decode(outputs, metadata | {"config": '{"spline": "pchip"}'})


def test_the_decoder_of_onnx_outputs_needs_numpy_alone():
    tree = ast.parse(inspect.getsource(onnx_decode))
    modules = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    modules |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert modules - set(sys.stdlib_module_names) - {"collections.abc"} == {"numpy"}


def test_visibility_is_written_and_read_and_changes_no_score(checkpoint, split, tmp_path):
    improved = _untrained(tmp_path / "best.pt", "improved")
    read = list(read_predictions(detected(improved, "DIR/test", tmp_path / "out", n_overlays=0).path))
    lanes = [lane for prediction in read for lane in prediction.lanes]
    assert len(lanes) > 5
    # Linear between the knots: constant before 5 m, and no kink between 60 and 80 m.
    for lane in lanes:
        assert lane.visibility.shape == (101,)
        assert ((lane.visibility > 0) & (lane.visibility < 1)).all()
        assert (lane.visibility[:6] == lane.visibility[5]).all()
        assert np.diff(lane.visibility[60:81], n=2) == pytest.approx(np.zeros(19), abs=3e-3)
    assert np.ptp([lane.visibility for lane in lanes]) > 1e-3
    plain = list(read_predictions(detected(checkpoint, "DIR/test", tmp_path / "plain", n_overlays=0).path))
    assert all(lane.visibility is None for prediction in plain for lane in prediction.lanes)

    found = [roads.as_prediction(sample.labels, sample.key) for sample in split]
    for name, value in (("seen", 0.9), ("hidden", 0.1)):
        marked = [
            dataclasses.replace(
                prediction,
                lanes=tuple(
                    dataclasses.replace(lane, visibility=np.full(len(lane.xyz_cam), value)) for lane in prediction.lanes
                ),
            )
            for prediction in found
        ]
        write_predictions(tmp_path / name, marked)
        assert evaluate_predictions(tmp_path / name, "DIR/test").kinds["centerline"].ap == pytest.approx(1.0)


def test_lanes_are_drawn_as_far_as_they_are_visible():
    prediction = roads.as_prediction(roads.labels([lambda y: (0 * y, 0 * y)]))
    camera = np.array([[200.0, 240, 0], [0, 180, -200], [0, 1, 0]])
    (whole,) = _lines(prediction, None, camera, 0.5)
    lane = prediction.lanes[0]
    visibility = np.where(np.arange(len(lane.xyz_cam)) % 30 < 20, 0.8, 0.3)
    part_seen = dataclasses.replace(prediction, lanes=(dataclasses.replace(lane, visibility=visibility),))
    drawn = [line.xyz_road for line in _lines(part_seen, None, camera, 0.5)]
    reach_m, is_ahead = lane.xyz_cam[:, 1], lane.xyz_cam[:, 1] > 0.5
    assert whole.xyz_road[:, 1].max() == pytest.approx(min(80.0, reach_m.max()))
    is_drawn = visibility[is_ahead][: len(whole.xyz_road)] > 0.5
    assert len(drawn) > 1
    np.testing.assert_array_equal(np.concatenate(drawn), whole.xyz_road[is_drawn])


@pytest.mark.parametrize(("size_px", "is_beside"), [((1640, 590), False), ((1280, 960), True), ((720, 1280), True)])
def test_pictures_follow_the_shape_of_the_image_and_one_has_its_size(tmp_path, size_px, is_beside):
    """The lines have the colours of labels' overlays: a label of each kind is hollow, a detection full in it."""
    labels = roads.labels([lambda y: (0 * y - 1, 0 * y), lambda y: (0 * y + 2, 0 * y)])
    lanes = (labels.lanes[0], dataclasses.replace(labels.lanes[1], kind="delimiter"))
    labels = dataclasses.replace(labels, lanes=lanes)
    prediction = roads.as_prediction(labels)
    width, height = size_px
    black, camera = np.zeros((height, width, 3), np.uint8), (width / 2, width / 2, width / 2, height / 2)
    for truth in (labels, ()):
        save_pictures(tmp_path / "a", CameraImage("a", black, camera, truth), prediction)
        with Image.open(tmp_path / "a.overlay.jpg") as picture:
            assert picture.size == size_px
            overlay = np.asarray(picture).astype(int)
        for lane, found in zip(lanes, prediction.lanes, strict=True):
            assert lane.kind == found.kind
            points_img = project(img_from_cam(camera), found.xyz_cam[10:12])
            u, v = np.floor(points_img.mean(axis=0)).astype(int)
            row, color = overlay[v], np.array(KINDS[lane.kind])
            assert abs(row[u] - color).max() < 60, "full"
            is_line = abs(row - color).max(axis=1) < 90
            n_lines = np.count_nonzero(np.diff(is_line.astype(int)) == 1)
            assert n_lines == (3 if truth else 1), "a line between the two of the label"
        with Image.open(tmp_path / "a.png") as figure:
            assert (figure.width > 100 * (5 * width / height + 5)) == is_beside
            assert min(figure.size) > 500


def test_statistics_count_every_lane(split):
    text = describe_targets("DIR/test")
    document = json.loads(describe_targets("DIR/test", as_json=True))
    n_lanes = sum(len(sample.labels.lanes) for sample in split)  # none of these repeats another
    assert sum(sum(counts.values()) for counts in document["counts"].values()) == n_lanes
    assert document["visible_share"]["20.0"] == 1.0
    assert "ceiling, centerline: AP 1.0000" in text


@pytest.mark.parametrize(
    ("n_gpus", "name", "chosen"),
    [
        *((0, "auto", "cpu"), (2, "auto", "cuda"), (2, "cuda:1", "cuda:1"), (2, "cpu", "cpu")),
        *((0, "cuda", ""), (2, "cuda:2", ""), (2, "gpu", "")),
    ],
)
def test_the_device_is_the_one_asked_for_or_refused(monkeypatch, n_gpus, name, chosen):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: n_gpus)
    if chosen:
        assert str(choose_device(name)) == chosen
    else:
        with pytest.raises(InputError, match=f"expected .*, got '{name}'"):
            choose_device(name)


@pytest.mark.thorough
def test_a_picture_of_the_largest_size_takes_less_than_a_gigabyte(tmp_path):
    """67 million pixels, decoded, resized and shown beside two smaller ones, in a process of its own."""
    for number, size_px in enumerate([(8192, 8192), (96, 72), (640, 360)]):
        Image.new("RGB", size_px, (90, 100, 110)).save(tmp_path / f"{number}.png")
    script = "import sys; from synth3dlanes_baseline.predict import detector_for, predict\n"
    script += "predict(detector_for(sys.argv[1]), *sys.argv[1:])\n"
    # Its own peak: `ru_maxrss` would have that of the process which started it, too.
    script += "sys.stdout.write(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"
    command = [sys.executable, "-c", script, str(tmp_path), str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=280)
    assert int(done.stdout) * 1024 < 1_000_000_000
    assert len(list((tmp_path / "out").glob("*.png"))) == 3
