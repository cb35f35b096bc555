"""Queries on an index agree with Python's own reading of them, and nothing but a query is ever run."""

import operator

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.dataset.columns import SCHEMA
from synth3dlanes.dataset.index import ADDED_SCHEMA
from synth3dlanes.dataset.query import rows_where
from synth3dlanes.system.errors import InputError

N_LANES = [2, 3, 4, 4, 3, 2]
GRADES = [0.0, 0.05, 0.1, 0.15, 0.2, -0.1]
FLIPS = [True, False, True, False, True, False]
JUNCTIONS = ["merge", "split", "none", "merge", "a = b and c", "none"]
INDEX = pa.table({"n_lanes": N_LANES, "max_grade": GRADES, "flip_lateral": FLIPS, "junction": JUNCTIONS})


queries = st.recursive(
    st.sampled_from(["flip_lateral", "n_lanes = 3", "max_grade > 0.07", "junction != 'none'"]),
    lambda inner: st.one_of(
        st.builds("not ({})".format, inner),
        st.builds("({}) {} ({})".format, inner, st.sampled_from(["and", "or"]), inner),
    ),
    max_leaves=8,
)


@given(queries)
def test_any_query_means_what_python_means(query: str) -> None:
    rows = [dict(zip(INDEX.column_names, row, strict=True)) for row in zip(*INDEX.to_pydict().values(), strict=True)]
    plain = query.replace(" = ", " == ")
    expected = [i for i, row in enumerate(rows) if eval(plain, {"__builtins__": {}}, row)]
    assert rows_where(INDEX, query).tolist() == expected


@pytest.mark.parametrize(
    ("where", "expected"),
    [
        ("n_lane = 4", "where n_lane = 4: unknown column n_lane; did you mean n_lanes?"),
        ("n_lanes", "expected a truth value, got a number: n_lanes"),
        ("n_lanes = 'four'", "expected a number, got text"),
        ("flip_lateral = 1", "expected a truth value, got a number"),
        ("__import__('os').system('touch pwned')", "expected columns, numbers"),
        ("n_lanes.real = 4", "expected columns, numbers"),
        ("n_lanes + 1 = 4", "expected columns, numbers"),
        ("(lambda: True)()", "expected columns, numbers"),
        ("junction = f'{n_lanes}'", "expected columns, numbers"),
        ("n_lanes in (2, 3)", "expected columns, numbers"),
        ("n_lanes = ", "expected columns, numbers"),
        ("(n_lanes = 2", "expected columns, numbers"),
        ("'open", "expected columns, numbers"),
        ("", "expected columns, numbers"),
        ("n_lanes = 1" + "0" * 40, "expected columns, numbers"),
        ("not " * 5000 + "flip_lateral", "expected columns, numbers"),
    ],
)
def test_what_is_no_query(where: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        rows_where(INDEX, where)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_column_of_a_real_index_can_be_asked_for() -> None:
    empty = pa.Table.from_pylist([], schema=pa.unify_schemas([SCHEMA, ADDED_SCHEMA]))
    for field in empty.schema:
        right = {pa.string(): "'x'", pa.bool_(): "true"}.get(field.type, "1")
        assert rows_where(empty, f"{field.name} = {right}").tolist() == []


def test_a_missing_value_fits_nothing() -> None:
    index = pa.table({"size": pa.array([1, None, 3])})
    for compare in (operator.eq, operator.ne):
        sign = "=" if compare is operator.eq else "!="
        assert (
            rows_where(index, f"size {sign} 1").tolist() == np.flatnonzero([compare(1, 1), 0, compare(3, 1)]).tolist()
        )
