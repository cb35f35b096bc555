"""Names of array types. A letter stands for one length throughout a signature, `_` for a length of its own."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int, Integer, Shaped, UInt8

# One number, or one point, for each of n. Points are in the frame that the variable's name ends in.
Scalars = Float[np.ndarray, " n"]
Points2 = Float[np.ndarray, "n 2"]
Points3 = Float[np.ndarray, "n 3"]
Ids = Integer[np.ndarray, " n"]

# The same for arrays of any shape, which is one throughout a signature; `Numbers` may have any shapes.
AnyScalars = Float[np.ndarray, "*n"]
AnyPoints2 = Float[np.ndarray, "*n 2"]
AnyPoints3 = Float[np.ndarray, "*n 3"]
Numbers = Float[np.ndarray, "..."]
# Numbers of shapes that are broadcast to one.
Spread = Float[np.ndarray, "*#n"]

# Points of a line, in order.
Polyline2 = Float[np.ndarray, "_ 2"]
Polyline3 = Float[np.ndarray, "_ 3"]

# A transform of homogeneous points, named `b_from_a`.
Matrix4 = Float[np.ndarray, "4 4"]

# Images: 8-bit colours as in files, colours in linear light, ids, flags.
RgbImage = UInt8[np.ndarray, "h w 3"]
LinearImage = Float[np.ndarray, "h w 3"]
IdImage = Int[np.ndarray, "h w"]
MaskImage = Bool[np.ndarray, "h w"]

# The passes of a sample by their names.
Passes = Mapping[str, Shaped[np.ndarray, "..."]]
