"""Select samples by a query on the columns of the index (`docs/format.md`), such as `flip_lateral and n_lanes = 4`. No
code of the query is executed."""

import ast
import io
import operator
import tokenize
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Int

from synth3dlanes.dataset.columns import TEXTS
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import did_you_mean

ValueKind = Literal["a truth value", "a number", "text"]
COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
WORDS = {"true": True, "false": False}
GRAMMAR = "columns, numbers, 'text', = != < <= > >=, and, or, not, parentheses"


class _Term(NamedTuple):
    """A piece of a query: what kind of value it has, how pyarrow computes it, and the column or the text that it is."""

    kind: ValueKind
    value: pc.Expression
    column: str = ""
    text: str | None = None


def rows_where(index: pa.Table, where: str) -> Int[np.ndarray, " k"]:
    """The positions of the rows for which the query holds, in order; a comparison with a missing value never does.

    Raises InputError with the closest column where one is unknown, and for a text that a column never has.
    """
    try:
        term = _read(ast.parse(_with_double_equals(where), mode="eval").body, index, where)
    except InputError:
        raise
    except (SyntaxError, tokenize.TokenError, ValueError, OverflowError, RecursionError, MemoryError):
        raise _problem(where, f"expected {GRAMMAR}, got something else") from None
    _expect(term, "a truth value", where)
    numbered = index.append_column("", pa.array(np.arange(index.num_rows)))
    return np.asarray(numbered.filter(term.value)[""].to_numpy())


def _with_double_equals(where: str) -> str:
    """The query with `==` for `=`, which Python's parser needs."""
    tokens = tokenize.generate_tokens(io.StringIO(" ".join(where.splitlines()).strip()).readline)
    return tokenize.untokenize((kind, "==" if text == "=" else text) for kind, text, *_ in tokens)


def _read(node: ast.expr, index: pa.Table, where: str) -> _Term:
    if isinstance(node, ast.Name):
        return _column(node.id, index, where)
    if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float | str):
        text = node.value if isinstance(node.value, str) else None
        return _Term(_kind_of(node.value), pc.scalar(node.value), text=text)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and isinstance(node.operand, ast.Constant):
        if isinstance(node.operand.value, int | float):
            return _Term("a number", pc.scalar(-node.operand.value))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return _Term("a truth value", ~_expect(_read(node.operand, index, where), "a truth value", where))
    elif isinstance(node, ast.BoolOp):
        parts = [_expect(_read(value, index, where), "a truth value", where) for value in node.values]
        return _joined(operator.and_ if isinstance(node.op, ast.And) else operator.or_, parts)
    elif isinstance(node, ast.Compare):
        return _comparison(node, index, where)
    raise _problem(where, f"expected {GRAMMAR}, got {ast.unparse(node)}")


def _comparison(node: ast.Compare, index: pa.Table, where: str) -> _Term:
    """One comparison, or a chain as in 2 < n_lanes < 4."""
    terms = [_read(part, index, where) for part in (node.left, *node.comparators)]
    parts = []
    for comparison, left, right in zip(node.ops, terms, terms[1:], strict=False):
        if type(comparison) not in COMPARISONS:
            raise _problem(where, f"expected {GRAMMAR}, got {ast.unparse(node)}")
        _expect(right, left.kind, where)
        if type(comparison) in (ast.Eq, ast.NotEq):
            _expect_text(left, right, index, where)
            _expect_text(right, left, index, where)
        parts.append(COMPARISONS[type(comparison)](left.value, right.value))
    return _joined(operator.and_, parts)


def _joined(join: Callable[[Any, Any], Any], parts: list[pc.Expression]) -> _Term:
    whole = parts[0]
    for part in parts[1:]:
        whole = join(whole, part)
    return _Term("a truth value", whole)


def _column(name: str, index: pa.Table, where: str) -> _Term:
    if name in WORDS:
        return _Term("a truth value", pc.scalar(WORDS[name]))
    if name not in index.column_names:
        raise _problem(where, f"unknown column {name}{did_you_mean(name, index.column_names)}")
    kind = index.schema.field(name).type
    if pa.types.is_boolean(kind):
        return _Term("a truth value", pc.field(name))
    return _Term("text" if pa.types.is_string(kind) else "a number", pc.field(name), column=name)


def _kind_of(value: bool | int | float | str) -> ValueKind:
    if isinstance(value, bool):
        return "a truth value"
    return "text" if isinstance(value, str) else "a number"


def _expect(term: _Term, kind: ValueKind, where: str) -> pc.Expression:
    if term.kind != kind:
        raise _problem(where, f"expected {kind}, got {term.kind}: {term.value}")
    return term.value


def _expect_text(column: _Term, text: _Term, index: pa.Table, where: str) -> None:
    """Raise InputError where a column is compared with a text that it can never have, and has nowhere in this index."""
    known = TEXTS.get(column.column, ())
    if not known or text.text is None or text.text in known:
        return
    if not pc.any(pc.equal(index[column.column], text.text)).as_py():
        near = did_you_mean(text.text, known)
        raise _problem(where, f"expected {column.column} to be one of {', '.join(known)}, got {text.text!r}{near}")


def _problem(where: str, text: str) -> InputError:
    return InputError(f"where {' '.join(where.split())}: {text}")
