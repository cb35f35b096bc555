"""What holds for all formats."""

import pytest

from synth3dlanes.errors import FormatError
from synth3dlanes.export import apollo, once, openlane, tusimple
from synth3dlanes.export.lines import scene_tags
from tests.export import closed_form as cf


@pytest.mark.parametrize("read", [apollo.read, openlane.read, once.read, tusimple.read])
@pytest.mark.parametrize("text", ["", "[]", "{}", '{"lanes": 3}'])
def test_a_wrong_file_is_a_format_error_that_names_it(read, text):
    with pytest.raises(FormatError, match=r"^some/file.json: "):
        read(text, "some/file.json")


def test_scene_tags():
    camera = cf.camera_label()
    assert scene_tags(cf.road(camera), apollo.VIEW) == set()
    assert scene_tags(cf.road(camera, curvature=0.004), apollo.VIEW) == {"curve"}
    assert scene_tags(cf.road(camera, slope=0.001), apollo.VIEW) == {"up_down", "steep"}
    leaving = cf.lane(camera, cf.curve(3.0), "exit", "centerline", road="exit")
    assert scene_tags(cf.labels_of(camera, leaving), apollo.VIEW) == {"merge_split"}
