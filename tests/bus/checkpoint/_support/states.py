"""States for tests, and a comparison: equal values of the same types, to the last bit."""

import math
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray


def same(left: Any, right: Any) -> bool:
    if type(left) is not type(right):
        return False
    if isinstance(left, np.ndarray | np.generic):
        return (left.dtype, left.shape, left.tobytes()) == (right.dtype, right.shape, right.tobytes())
    if isinstance(left, list | tuple):
        return len(left) == len(right) and all(map(same, left, right))
    if isinstance(left, dict):
        return same(list(left.items()), list(right.items()))
    if isinstance(left, float):
        return (math.isnan(left) and math.isnan(right)) or str(left) == str(right)
    return bool(left == right)


DTYPES = st.one_of(
    arrays.scalar_dtypes(),
    arrays.byte_string_dtypes(),
    arrays.unicode_string_dtypes(),
)
VIEWS = (
    lambda array: array,
    lambda array: array.T,
    lambda array: array[::-2],
    np.asfortranarray,
    lambda array: np.broadcast_to(array, (3, *array.shape)),
)


@st.composite
def any_array(draw: st.DrawFn) -> NDArray[Any]:
    """An array of any type that may be kept, also empty, not contiguous, or of the other byte order."""
    shape = draw(arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4))
    array = draw(arrays.arrays(draw(DTYPES), shape))
    return array if array.ndim == 0 else draw(st.sampled_from(VIEWS))(array)


SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.integers(-(10**60), 10**60),
    st.floats(),
    st.text(),
    st.binary(),
)
NUMPY_SCALARS = any_array().filter(lambda array: array.ndim == 0).map(lambda array: array[()])
KEYS = st.one_of(SCALARS, st.tuples(st.integers(), st.text()))
STATES = st.recursive(
    st.one_of(SCALARS, any_array(), NUMPY_SCALARS),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.lists(inner, max_size=4).map(tuple),
        st.dictionaries(KEYS, inner, max_size=4),
    ),
    max_leaves=12,
)
