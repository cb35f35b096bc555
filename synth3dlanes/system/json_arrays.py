"""Arrays in JSON documents: the form that each is read from, its shape and its type."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import FailFast, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from synth3dlanes.system.schema import MAX_PX, Number, Positive


@dataclass(frozen=True)
class _Json:
    """The JSON form of an array, and its shape and type."""

    form: Any
    shape: tuple[int, ...]
    dtype: type

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        form = handler.generate_schema(Annotated[self.form, FailFast()])
        return core_schema.no_info_after_validator_function(self._array, form)

    def _array(self, values: Any) -> np.ndarray:
        return np.array(values, self.dtype).reshape(self.shape)


PixelEdge = Annotated[int, Field(ge=0, le=MAX_PX)]
Deviation = Annotated[float, Field(ge=0, le=1e6)]
Row3: TypeAlias = tuple[Number, Number, Number]
Row4: TypeAlias = tuple[Number, Number, Number, Number]
JsonMatrix3 = Annotated[Float[np.ndarray, "3 3"], _Json(tuple[Row3, Row3, Row3], (3, 3), float)]
JsonMatrix4 = Annotated[Float[np.ndarray, "4 4"], _Json(tuple[Row4, Row4, Row4, Row4], (4, 4), float)]
JsonPoints = Annotated[Float[np.ndarray, "n 3"], _Json(list[Row3], (-1, 3), float)]
JsonPairs = Annotated[Float[np.ndarray, "n 2"], _Json(list[tuple[Deviation, Deviation]], (-1, 2), float)]
JsonMask = Annotated[Bool[np.ndarray, " n"], _Json(list[Literal[0, 1]], (-1,), bool)]
JsonVector3 = Annotated[Float[np.ndarray, "3"], _Json(Row3, (3,), float)]
JsonSize3 = Annotated[Float[np.ndarray, "3"], _Json(tuple[Positive, Positive, Positive], (3,), float)]
JsonRectangle = Annotated[Float[np.ndarray, "4"], _Json(Row4, (4,), float)]
JsonPixelRectangle = Annotated[
    Int[np.ndarray, "4"], _Json(tuple[PixelEdge, PixelEdge, PixelEdge, PixelEdge], (4,), int)
]
JsonQuaternion = Annotated[Float[np.ndarray, "4"], _Json(Row4, (4,), float)]


def rounded(values: Float[np.ndarray, "..."], decimals: int) -> Any:
    """Values as lists of numbers of `decimals` decimals; equal numbers give equal text."""
    # Adding 0.0 turns -0.0 into 0.0.
    return (np.round(values, decimals) + 0.0).tolist()
