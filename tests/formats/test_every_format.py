"""What holds for all formats."""

import pytest

from synth3dlanes.formats import apollo, once, openlane, tusimple
from synth3dlanes.formats.apollo import CAMERA
from synth3dlanes.formats.lines import scene_tags
from synth3dlanes.system.errors import FormatError
from tests.formats import closed_form as cf


@pytest.mark.parametrize("parse", [apollo.parse, openlane.parse, once.parse, tusimple.parse])
@pytest.mark.parametrize("text", ["", "[]", "{}", '{"lanes": 3}'])
def test_a_wrong_file_is_a_format_error_that_names_it(parse, text):
    with pytest.raises(FormatError, match=r"^some/file.json: "):
        parse(text, "some/file.json")


def test_scene_tags():
    camera = cf.camera_label()
    assert scene_tags(cf.road(camera), CAMERA) == set()
    assert scene_tags(cf.road(camera, curvature=0.004), CAMERA) == {"curve"}
    assert scene_tags(cf.road(camera, slope=0.001), CAMERA) == {"up_down", "steep"}
    leaving = cf.lane(camera, cf.curve(3.0), "exit", "centerline", road="exit")
    assert scene_tags(cf.labels_of(camera, leaving), CAMERA) == {"merge_split"}
