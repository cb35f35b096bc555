"""What `verify` finds in an export, in lines."""

from synth3dlanes.formats.export import Export
from synth3dlanes.formats.verify import verify


def problems(source, out, format_name, most_frames=100):
    """All problems of all lists."""
    results = verify(Export(str(source), out, format_name), most_frames)
    return [problem for result in results for problem in result.problems]
