"""The scores against known answers, which were measured with the benchmarks' own evaluators.

Commits: Gen-LaneNet 45c6cc4, OpenLane 8a0ce6b, once_3dlanes_benchmark 7582fbb, tusimple-benchmark d1f5ef1.
"""

import numpy as np
import pytest

from synth3dlanes.formats.once import benchmark as score_once
from synth3dlanes.formats.scoring import GEN_LANENET, OPENLANE, Canvas, Line3d, line_score, prune
from synth3dlanes.formats.scoring import band_score as score_bands
from synth3dlanes.formats.tusimple import mean_score, score_frame

ROWS_PX = np.arange(160.0, 720.0, 10.0)


def line(x_m=0.0, start_m=1.0, end_m=108.0, visible_to_m=np.inf, slope=0.0, category=1):
    """A line straight ahead with a point every metre."""
    y_m = np.arange(start_m, end_m + 0.5)
    points = np.column_stack([np.full(len(y_m), x_m), y_m, slope * y_m])
    return Line3d(points, y_m <= visible_to_m, category)


FOUR = [line(x) for x in (-5.4, -1.8, 1.8, 5.4)]


def score_apollo(frames):
    return line_score(frames, GEN_LANENET)


def score_openlane(frames):
    return line_score(frames, OPENLANE)


def score_tusimple(frames, rows_px):
    return mean_score([score_frame(true, predicted, rows_px) for true, predicted in frames])


@pytest.mark.parametrize("score", [score_apollo, score_openlane])
def test_ground_truth_is_perfect_and_two_metres_aside_is_nothing(score):
    perfect = score([(FOUR, [prune(x, GEN_LANENET) for x in FOUR])] * 3)
    assert (perfect["recall"], perfect["precision"]) == (1, 1)
    assert 0.99999 < perfect["f_score"] < 1
    assert (perfect["x_near_m"], perfect["x_far_m"], perfect["z_near_m"], perfect["z_far_m"]) == (0, 0, 0, 0)
    assert score([(FOUR, [line(x.points_ground[0, 0] + 2) for x in FOUR])])["f_score"] < 1e-6


def test_a_line_is_found_if_three_quarters_of_it_are():
    for end_m, recall in ((75.0, 0), (79.0, 1)):
        assert score_apollo([([line()], [line(end_m=end_m)])])["recall"] == recall


@pytest.mark.parametrize("score", [score_apollo, score_openlane])
def test_errors_read_in_metres(score):
    found = score([([line(slope=0.01)], [line(0.1)])])
    assert found["f_score"] > 0.999
    assert found["x_near_m"] == pytest.approx(0.1)
    assert found["x_far_m"] == pytest.approx(0.1)
    assert found["z_near_m"] == pytest.approx(0.01 * np.arange(3, 41).mean())
    assert found["z_far_m"] == pytest.approx(0.01 * np.arange(41, 103).mean())


def test_apollo_ap_is_one_for_perfect_and_a_half_for_nothing():
    assert score_apollo([(FOUR, FOUR)])["ap"] == pytest.approx(1.0)
    assert score_apollo([(FOUR, [])])["ap"] == pytest.approx(0.5)


HALF_SEEN = [line(x, visible_to_m=50) for x in (-1.8, 1.8)]
# True and predicted lines, and what the two evaluators say of them.
ODDITIES = {
    "a line outside the band caps Gen-LaneNet's recall": (
        [*FOUR[:3], line(15.0)], None, {"f_score": 0.75, "ap": 0.763}, {"f_score": 1.0}
    ),
    "a missing far part is charged by Gen-LaneNet": (
        [*FOUR[:3], line(5.4, end_m=30.0)], None, {"x_far_m": 0.375}, {"x_far_m": 0.0}
    ),
    "the prediction of a half visible line over its full length has no precision": (
        HALF_SEEN, [line(-1.8), line(1.8)], {"precision": 0.0, "f_score": 0.0, "recall": 1.0}, {}
    ),
    "a true line beyond the range is dropped, its prediction is not": (
        [*FOUR[:3], line(5.4, start_m=103.0, end_m=120.0)], None, {"precision": 0.75}, {}
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ODDITIES)
def test_oddities_of_the_evaluators_in_space(name):
    true, predicted, *expected = ODDITIES[name]
    for score, told in zip((score_apollo, score_openlane), expected, strict=True):
        found = score([(true, true if predicted is None else predicted)])
        assert {key: found[key] for key in told} == pytest.approx(told, abs=1e-3 if "ap" in told else 1e-6)


def test_lines_written_far_to_near_are_dropped():
    backwards = [Line3d(x.points_ground[::-1], x.visible) for x in FOUR]
    for score in (score_apollo, score_openlane):
        found = score([(backwards, backwards)])
        assert found["f_score"] == 0
        assert np.isnan(found["x_near_m"])


def test_apollo_prediction_of_one_point_is_refused():
    with pytest.raises(AssertionError):
        score_apollo([(FOUR, [Line3d(FOUR[0].points_ground[:1], np.ones(1, dtype=bool))])])


def test_openlane_category_accuracy_counts_equal_ids_and_one_way_curbs():
    x_m = (-3.6, 0.0, 3.6)
    true = [line(x, category=c) for x, c in zip(x_m, (2, 21, 20), strict=True)]
    predicted = [line(x, category=c) for x, c in zip(x_m, (2, 20, 21), strict=True)]
    assert score_openlane([(true, predicted)])["category_accuracy"] == pytest.approx(2 / 3)


@pytest.mark.parametrize("score", [score_apollo, score_openlane])
def test_empty_frames_change_nothing(score):
    assert repr(score([(FOUR, FOUR), ([], [])])) == repr(score([(FOUR, FOUR)]))
    assert score([([], [])])["f_score"] == 0


def once_lane(x_m, start_m=5.0):
    z_m = np.arange(start_m, 90.0)[::-1]
    return np.column_stack([np.full(len(z_m), x_m), np.full(len(z_m), 1.5), z_m])


def test_once_perfect_shifted_and_distance():
    true = [once_lane(x) for x in (-5.4, -1.8, 1.8)]
    perfect = score_once([(true, true)] * 2 + [([], [])])
    assert (perfect["f_score"], perfect["distance_m"]) == (1, 0)
    assert score_once([(true, true[::-1])])["f_score"] == 1, "the order does not matter where lines can be assigned"
    assert score_once([(true, [x + np.array([2.0, 0, 0]) for x in true])])["f_score"] == 0
    found = score_once([(true, [x + np.array([0.1, 0, 0]) for x in true])])
    assert found["f_score"] == 1
    assert found["distance_m"] == pytest.approx(0.1)
    assert score_once([(true, [x + np.array([0.35, 0, 0]) for x in true])])["f_score"] == 0, "0.3 m at most"


def test_once_cannot_assign_permuted_lines_that_begin_beyond_ten_metres():
    true = [once_lane(x, start_m=12.0) for x in (-5.4, -1.8, 1.8)]
    assert score_once([(true, true)])["f_score"] == 1
    assert score_once([(true, [true[1], true[2], true[0]])])["f_score"] == 0


def tusimple_lines(n, slope=0.5):
    return np.where(ROWS_PX >= 300, 300.0 + 100 * np.arange(n)[:, None] + slope * (ROWS_PX - 300), -2.0)


def test_tusimple_oddities_of_the_official_accuracy():
    def accuracy(n):
        return score_tusimple([(tusimple_lines(n), tusimple_lines(n))], ROWS_PX).accuracy

    assert (accuracy(0), accuracy(5), accuracy(6)) == (0, 1, 1.25)
    too_many = score_tusimple([(tusimple_lines(2), tusimple_lines(5))], ROWS_PX)
    assert (too_many.accuracy, too_many.false_positive, too_many.false_negative) == (0, 0, 1)


def test_tusimple_accuracy_by_hand():
    rows = np.arange(160.0, 711.0, 50.0)

    def rates(found, true):
        one = score_frame(*(np.array(lines, dtype=float).reshape(-1, len(rows)) for lines in (true, found)), rows)
        return one.accuracy, one.false_positive, one.false_negative

    upright = np.full(len(rows), 600.0)
    assert rates([upright], [upright]) == (1.0, 0.0, 0.0)
    assert rates([upright + 19], [upright])[0] == 1.0
    assert rates([upright + 21], [upright]) == (0.0, 1.0, 1.0)
    leaning = 400.0 + rows
    assert rates([leaning + 27], [leaning])[0] == 1.0, "20 px across is 28 along the row"
    assert rates([leaning + 29], [leaning])[0] == 0.0
    assert rates([upright] * 4, [upright]) == (0.0, 0.0, 1.0)
    assert rates([], [upright]) == (0.0, 0.0, 1.0)
    absent = np.where(rows < 400, -2.0, upright)
    assert rates([absent], [absent])[0] == 1.0, "absent on both sides is right"
    assert rates([np.where(absent < 0, -2.0, 650.0)], [absent]) == (pytest.approx(np.mean(rows < 400)), 1.0, 1.0)
    five = [np.full(len(rows), 100.0 * i) for i in range(1, 6)]
    assert rates(five[:4], five) == (1.0, 0.0, 0.0), "the worst of five does not count"


CULANE = Canvas(1640, 590, 30, 0.5)


def upright(x_px=800.0, top_px=300.0):
    return np.column_stack([np.full(30, x_px), np.linspace(590.0, top_px, 30)])


def test_bands_of_thirty_pixels_match_when_less_than_ten_apart():
    # Bands of width w that are d apart overlap by (w - d) / (w + d): one half at d = w / 3. OpenCV draws 31 pixels.
    for aside_px, is_matched in ((0, True), (5, True), (10, True), (11, False), (31, False)):
        found = score_bands([([upright()], [upright(800 + aside_px)])], CULANE)
        assert (found["f_score"], found["recall"], found["precision"]) == ((1, 1, 1) if is_matched else (0, 0, 0))


def test_bands_count_missed_and_invented_lines():
    true = [upright(x) for x in (300, 700, 900, 1300)]
    found = score_bands([(true, true[::-1])], CULANE)
    assert (found["f_score"], found["recall"], found["precision"]) == (1, 1, 1), "the order does not matter"
    found = score_bands([(true, true[:1]), ([], [upright()]), ([], [])], CULANE)
    assert (found["recall"], found["precision"]) == (0.25, 0.5)
    assert found["f_score"] == pytest.approx(2 * 0.25 * 0.5 / 0.75)
    assert score_bands([([], [])], CULANE)["f_score"] == 0


def test_bands_are_paired_for_the_greatest_overlap_in_all():
    # The middle one overlaps both, more with the first; alone it would take the first away from its own.
    true, predicted = [upright(800), upright(816)], [upright(807), upright(793)]
    assert score_bands([(true, predicted)], CULANE)["recall"] == 1


def test_bands_follow_a_spline_and_stop_where_lines_stop():
    # The polyline through the five points overlaps by 0.77.
    coarse, fine = (
        np.column_stack([400 + 600 * t**2, 590 - 300 * t]) for t in (np.linspace(0, 1, n) for n in (5, 200))
    )
    assert score_bands([([coarse], [fine])], Canvas(1640, 590, 30, 0.85))["f_score"] == 1
    assert score_bands([([upright()], [upright(top_px=460.0)])], CULANE)["f_score"] == 0, "less than half as long"
    assert score_bands([([upright()], [upright(top_px=430.0)])], CULANE)["f_score"] == 1
