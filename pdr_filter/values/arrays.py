"""Array types, conversion to read-only arrays, and small column tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Array of floats of any shape.
FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: Array of whole numbers of any shape.
IntArray = NDArray[np.int64]
#: Array of True and False of any shape.
BoolArray = NDArray[np.bool_]

# Column table as a NumPy record array: `table.time_s` and `table["time_s"]` are columns, and `len(table)` is the number
# of rows. `pandas.DataFrame(table)` converts it, so that this package does not depend on pandas.
Table = np.recarray[Any, Any]


def as_floats(values: ArrayLike, name: str) -> FloatArray:
    """Return values as a float64 array, with NaN in place of masked values.

    ValueError for dates and durations, whose unit is unknown, and for values that are not real numbers.
    """
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values
    try:
        array: Any = np.asanyarray(values)
    except ValueError as error:  # rows of different lengths
        raise ValueError(f"{name} must be an array of numbers, got {str(values)[:60]}: {error}") from None
    if array.dtype.kind in "mM":
        raise ValueError(
            f"{name} must be numbers, got {array.dtype}: give seconds, such as (t - t[0]) / np.timedelta64(1, 's')"
        )
    if array.dtype.kind == "c":
        raise ValueError(f"{name} must be real numbers, got {array.dtype}: give real and imaginary parts separately")
    if isinstance(array, np.ma.MaskedArray):
        array = cast(Any, array.astype(np.float64)).filled(np.nan)
    try:
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:  # words, objects
        raise ValueError(f"{name} must be numbers, got {str(values)[:60]}: {error}") from None


def median(values: FloatArray) -> float:
    """Return the median of a non-empty array (N,) without NaN, in a fifth of the time of np.median."""
    order = np.sort(values)
    return 0.5 * float(order[(len(order) - 1) // 2] + order[len(order) // 2])


def finite_only(values: FloatArray) -> FloatArray:
    """Return the finite values of an array (N,), without a copy if all are finite."""
    known = np.isfinite(values)
    return values if known.all() else values[known]


def read_only(values: ArrayLike, name: str = "values") -> FloatArray:
    """Return a read-only contiguous float64 copy of the values."""
    return make_read_only(np.array(as_floats(values, name), order="C"))


def make_read_only(array: FloatArray) -> FloatArray:
    """Make an array read-only and return it. For arrays that no other code refers to."""
    array.flags.writeable = False
    return array


def reduction(self: Any) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """Implement `__reduce__` for a dataclass with read-only arrays, because NumPy forgets this flag in copies."""
    return _restored_copy, (type(self), {f.name: getattr(self, f.name) for f in fields(self)})


def _restored_copy(cls: type[Any], values: Mapping[str, Any]) -> Any:
    value = object.__new__(cls)
    for name, own in values.items():
        object.__setattr__(value, name, make_read_only(own.view()) if isinstance(own, np.ndarray) else own)
    return value


def table(columns: Mapping[str, ArrayLike]) -> Table:
    """Create a read-only column table from columns of equal length.

    Parameters
    ----------
    columns : mapping of str to array_like
        Columns by name, of equal length.

    Returns
    -------
    numpy.recarray
        Table with one row for each element. `pandas.DataFrame(table)` converts it.

    Examples
    --------
    >>> from pdr_filter.values.arrays import table
    >>> steps = table({"time_s": [0.5, 1.0], "length_m": [0.7, 0.72]})
    >>> len(steps), steps.time_s.tolist()
    (2, [0.5, 1.0])
    """
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    length = len(next(iter(arrays.values())))
    result = np.zeros(length, dtype=[(name, array.dtype) for name, array in arrays.items()])
    for name, array in arrays.items():
        result[name] = array
    result.flags.writeable = False
    return result.view(np.recarray)


def check_columns(rows: Table, kinds: Mapping[str, str], name: str) -> None:
    """Raise ValueError unless a table has the given columns, each of one of the given NumPy kinds.

    Kinds are letters: U for text, b for truth values, i for whole numbers, f for floats.
    """
    for column, of in kinds.items():
        if column not in (rows.dtype.names or ()) or rows.dtype[column].kind not in of:
            raise ValueError(
                f"{name} must have a column {column} of NumPy kind {' or '.join(of)} (U text, b True or False, i whole "
                f"numbers, f floats), got {rows.dtype}: keep the columns as pdr_filter made them"
            )


def check_cov(cov: FloatArray, name: str) -> None:
    """Raise ValueError unless covariances (..., n, n) are finite, symmetric and semidefinite up to rounding."""
    tolerance = 1e-9 * np.abs(cov).max(initial=0.0)
    if not np.isfinite(cov).all() or np.abs(cov - np.swapaxes(cov, -1, -2)).max(initial=0.0) > tolerance:
        raise ValueError(f"{name} must be finite and symmetric, got {cov}")
    if cov.size and np.linalg.eigvalsh(cov).min() < -tolerance:
        raise ValueError(f"{name} must have no negative eigenvalue, got {cov}")


def check_transition_prob(transition_prob: FloatArray, n: int, name: str = "transition_prob") -> None:
    """Raise ValueError for a matrix that does not hold transition probabilities.

    Parameters
    ----------
    transition_prob : (n, n) array
        Probability of a transition from i to j in row i and column j. Rows must sum to one.
    n : int
        Number of states.
    name : str, default "transition_prob"
        Name of the argument in the message.

    Raises
    ------
    ValueError
        If the shape is wrong, a probability is negative, or a row does not sum to one.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values.arrays import check_transition_prob
    >>> check_transition_prob(np.array([[0.9, 0.1], [0.2, 0.8]]), 2)
    """
    if transition_prob.shape != (n, n):
        raise ValueError(f"{name} must be ({n}, {n}), one row for each previous state, got {transition_prob.shape}")
    of_row = transition_prob.sum(axis=1)
    wrong = (transition_prob < 0).any(axis=1) | ~np.isclose(of_row, 1.0, atol=1e-9)  # NaN and infinity too
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ValueError(
            f"rows of {name} must be probabilities and must sum to 1, row {row} is {transition_prob[row]} with sum "
            f"{of_row[row]}: transpose the matrix if its columns sum to 1"
        )
