# ruff: noqa: N803, N806 - the letters of the equations
"""The interacting multiple model compiled by numba: the functions of `pdr_filter.imm`, and a whole cycle in one pass.

NumPy writes every intermediate result of all pedestrians to memory, (..., M, M, n, n) of them in the mixing. Here a
pedestrian is filtered from the first to the last sum while its numbers are in the cache of the core, and `cycle`
filters four side by side in the lanes of vectors, which is ten times as fast. `pdr_filter.imm` is the reference: same
names, arguments and results, to rounding, with four differences. Covariances are taken as symmetric; trailing shapes
must be exactly the documented ones, since compiled loops do not check an index; an innovation covariance that is not
positive gives NaN or infinity instead of an error or a warning; and no result is ever one of the arguments.

Needs the extra `fast` (numba). The first call of a function compiles it, which takes up to half a minute; the code is
kept in `__pycache__`, later processes load it. numba is imported with this module and nowhere else.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing import templates
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model
from numba.np import arrayobj

from pdr_filter.types import FloatArray

_LANES = 4  # pedestrians in a vector: 32 bytes, a register of AVX; eight were no faster on Zen 4 with AVX-512
_LOG_2_PI = math.log(2 * math.pi)
_Function = TypeVar("_Function", bound=Callable[..., Any])
_written = cast(Callable[[Any], Any], intrinsic)  # instructions of LLVM, written into the callers

# A product may be fused with its sum. "nnan" and "ninf" stay out: NaN and infinity mean something. "reassoc" stays out:
# it made these short sums 10 % slower.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}
_IN_OTHERS: dict[str, Any] = {**_OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def _compiled(function: _Function) -> _Function:
    """Compiled, called from Python, without the lock of the interpreter, so that threads share the pedestrians."""
    return cast(_Function, numba.njit(nogil=True, cache=True, **_OPTIONS)(function))


def _inlined(function: _Function) -> _Function:
    """Compiled into its callers, so that loops over a number of states that they know are unrolled."""
    return cast(_Function, numba.njit(forceinline=True, **_IN_OTHERS)(function))


def _copied(function: _Function) -> _Function:
    """Copied into its callers as source, and compiled only there: half the time to compile for what is large."""
    return cast(_Function, numba.njit(inline="always", **_IN_OTHERS)(function))


class Cycle(NamedTuple):
    """What `cycle` returns: the state of the next cycle (three fields), and what is only looked at."""

    mean: FloatArray  # (..., M, n)
    cov: FloatArray  # (..., M, n, n)
    mode_prob: FloatArray  # (..., M)
    combined_mean: FloatArray  # (..., n)
    combined_cov: FloatArray  # (..., n, n)
    nis: FloatArray  # (..., M)


def mix(
    mean: FloatArray, cov: FloatArray, mode_prob: FloatArray, transition_prob: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """As `pdr_filter.imm.mix`."""
    M, n = mean.shape[-2:]
    inputs = {
        "mean": (mean, (M, n)),
        "cov": (cov, (M, n, n)),
        "mode_prob": (mode_prob, (M,)),
        "transition_prob": (transition_prob, (M, M)),
    }
    return _for_each(_mix_all, inputs, [(M, n), (M, n, n), (M,)])


def predict(mean: FloatArray, cov: FloatArray, F: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """As `pdr_filter.imm.predict`."""
    M, n = mean.shape[-2:]
    inputs = {"mean": (mean, (M, n)), "cov": (cov, (M, n, n)), "F": (F, (M, n, n)), "Q": (Q, (M, n, n))}
    return _for_each(_predict_all, inputs, [(M, n), (M, n, n)])


def update(
    mean: FloatArray, cov: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """As `pdr_filter.imm.update`, Joseph's form included."""
    M, n = mean.shape[-2:]
    d = z.shape[-1]
    inputs = {
        "mean": (mean, (M, n)),
        "cov": (cov, (M, n, n)),
        "z": (z, (d,)),
        "H": (H, (d, n)),
        "R": (R, (d, d)),
    }
    return _for_each(_update_all, inputs, [(M, n), (M, n, n), (M,), (M,)])


def update_mode_prob(predicted_mode_prob: FloatArray, log_likelihood: FloatArray) -> FloatArray:
    """As `pdr_filter.imm.update_mode_prob`."""
    M = predicted_mode_prob.shape[-1]
    inputs = {"predicted_mode_prob": (predicted_mode_prob, (M,)), "log_likelihood": (log_likelihood, (M,))}
    return _for_each(_update_mode_prob_all, inputs, [(M,)])[0]


def combine(mean: FloatArray, cov: FloatArray, mode_prob: FloatArray) -> tuple[FloatArray, FloatArray]:
    """As `pdr_filter.imm.combine`."""
    M, n = mean.shape[-2:]
    inputs = {"mean": (mean, (M, n)), "cov": (cov, (M, n, n)), "mode_prob": (mode_prob, (M,))}
    return _for_each(_combine_all, inputs, [(n,), (n, n)])


def cycle(
    mean: FloatArray,
    cov: FloatArray,
    mode_prob: FloatArray,
    transition_prob: FloatArray,
    F: FloatArray,
    Q: FloatArray,
    z: FloatArray,
    H: FloatArray,
    R: FloatArray,
    *,
    n_threads: int = 1,
) -> Cycle:
    """One cycle: `mix`, `predict`, `update`, `update_mode_prob`, `combine` of `pdr_filter.imm`, with their shapes.

    An argument without leading axes is shared by all pedestrians. The number of threads changes no bit of the result.
    """
    M, n = mean.shape[-2:]
    d = z.shape[-1]
    inputs = {
        "mean": (mean, (M, n)),
        "cov": (cov, (M, n, n)),
        "mode_prob": (mode_prob, (M,)),
        "transition_prob": (transition_prob, (M, M)),
        "F": (F, (M, n, n)),
        "Q": (Q, (M, n, n)),
        "z": (z, (d,)),
        "H": (H, (d, n)),
        "R": (R, (d, d)),
    }
    # Six modes of four states and a position, as in the recipes: loops of known lengths are twice as fast.
    kernel = _cycle_usual if (M, n, d) == (6, 4, 2) else _cycle_any
    return Cycle(*_for_each(kernel, inputs, [(M, n), (M, n, n), (M,), (n,), (n, n), (M,)], n_threads))


# --- between Python and compiled code ---------------------------------------------------------------------------------


def _for_each(
    kernel: Callable[..., None],
    inputs: dict[str, tuple[FloatArray, tuple[int, ...]]],
    results: list[tuple[int, ...]],
    n_threads: int = 1,
) -> tuple[Any, ...]:
    """Results of a kernel that is given the range of the pedestrians, arrays with one leading axis, and the results."""
    batch: tuple[int, ...] = ()
    for array, core in inputs.values():
        leading = array.shape[: max(array.ndim - len(core), 0)]
        if leading not in ((), batch):
            batch = np.broadcast_shapes(batch, leading)
    size = math.prod(batch)
    rows = [_rows(name, array, core, batch, size) for name, (array, core) in inputs.items()]
    found = [np.empty((size, *core)) for core in results]
    if n_threads == 1:
        kernel(0, size, *rows, *found)
    else:
        ends = [size * k // n_threads for k in range(n_threads + 1)]
        with ThreadPoolExecutor(n_threads) as pool:
            for done in [pool.submit(kernel, *ends[k : k + 2], *rows, *found) for k in range(n_threads)]:
                done.result()
    return tuple(array.reshape(batch + array.shape[1:]) for array in found)


def _rows(name: str, array: FloatArray, core: tuple[int, ...], batch: tuple[int, ...], size: int) -> FloatArray:
    """Array with one leading axis: of length one if the pedestrians share it, of length `size` if not.

    Read-only, so that numba, to which that is another type, compiles one version, and one that cannot write to it.
    """
    if array.shape == core:
        rows = array[None]
    elif array.shape[array.ndim - len(core) :] == core:
        rows = np.broadcast_to(array, batch + core).reshape(size, *core)
    else:
        raise ValueError(f"{name} must have the trailing shape {core}, got {array.shape}")
    rows = np.ascontiguousarray(rows, dtype=np.float64)
    rows.setflags(write=False)
    return rows


# --- vectors ----------------------------------------------------------------------------------------------------------


class _Vector(types.Type):
    """A number of each of `_LANES` pedestrians, in one register: the core calculates with all of them at once.

    Compiled code adds, subtracts, multiplies, divides vectors, and numbers with vectors, as it does numbers: the same
    functions of one pedestrian serve for either. By itself LLVM makes no vectors of these short sums.
    """

    def __init__(self) -> None:
        super().__init__(name=f"Vector{_LANES}")

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        return Conversion.promote if other == types.float64 else None


_VECTOR = _Vector()
_REGISTER = ir.VectorType(ir.DoubleType(), _LANES)
_INDICES = [ir.Constant(ir.IntType(32), lane) for lane in range(_LANES)]


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _REGISTER)


def _of_lanes(builder: Any, numbers: list[Any]) -> Any:
    vector = ir.Constant(_REGISTER, ir.Undefined)
    for index, number in zip(_INDICES, numbers, strict=True):
        vector = builder.insert_element(vector, number, index)
    return vector


@lower_cast(types.float64, _Vector)
def _same_in_each(context: Any, builder: Any, number_type: Any, vector_type: Any, number: Any) -> Any:
    return _of_lanes(builder, [number] * _LANES)


def _log(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    log = context.get_function(math.log, types.float64(types.float64))
    return _of_lanes(builder, [log(builder, [builder.extract_element(args[0], index)]) for index in _INDICES])


def _instruction(name: str) -> Callable[..., Any]:
    def lowered(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return getattr(builder, name)(*args)

    return lowered


class _OfVectors(templates.AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return _VECTOR(*[_VECTOR] * len(args)) if _VECTOR in args else None


def _define(function: Any, lowered: Callable[..., Any], n_arguments: int = 2) -> None:
    cast(Any, templates).infer_global(function)(type("_OfVectors", (_OfVectors,), {}))
    lower_builtin(function, *[_Vector] * n_arguments)(lowered)


_define(math.log, _log, 1)
for _name, _found in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    _define(getattr(operator, _name), _instruction(_found))
    _define(getattr(operator, f"i{_name}"), _instruction(_found))


@_written
def _if_positive(typingctx: Any, condition: Any, yes: Any, no: Any) -> Any:
    """`yes if condition > 0 else no`, of numbers, or of each number of vectors."""

    def lowered(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        positive = builder.fcmp_ordered(">", args[0], ir.Constant(args[0].type, None))
        return builder.select(positive, *args[1:])

    return condition(condition, condition, condition), lowered


@_written
def _vectors(typingctx: Any, shapes: Any) -> Any:
    """Arrays of vectors of these shapes, not filled, in one piece of memory: LLVM sees that they do not overlap."""
    arrays = types.Tuple([types.Array(_VECTOR, len(shape), "C") for shape in shapes])
    n_bytes = 8 * _LANES

    def lowered(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        shapes = cgutils.unpack_tuple(builder, args[0])
        begins, strides = [ir.Constant(ir.IntType(64), 0)], []
        for shape in shapes:
            steps = [ir.Constant(ir.IntType(64), n_bytes)]
            for length in reversed(cgutils.unpack_tuple(builder, shape)):
                steps.insert(0, builder.mul(steps[0], length))
            begins.append(builder.add(begins[-1], steps[0]))
            strides.append(steps[1:])
        memory = context.nrt.meminfo_alloc_aligned(builder, begins.pop(), n_bytes)
        first, made = context.nrt.meminfo_data(builder, memory), []
        for array_type, shape, begin, steps in zip(arrays, shapes, begins, strides, strict=True):
            array = arrayobj.make_array(array_type)(context, builder)
            data = builder.bitcast(builder.gep(first, [begin]), array.data.type)
            arrayobj.populate_array(array, data, shape, steps, n_bytes, memory)
            if made:  # the first has the reference of the allocation
                context.nrt.incref(builder, array_type, array._getvalue())
            made.append(array._getvalue())
        return context.make_tuple(builder, arrays, made)

    return arrays(types.Tuple([types.UniTuple(types.int64, len(shape)) for shape in shapes])), lowered


@_copied
def _gather(rows: FloatArray, k: int, begin: int, end: int, vectors: Any) -> None:
    """Vectors of the pedestrians from k, beyond the last the last again; what all share is gathered once."""
    if k == begin or len(rows) > 1:
        numbers = vectors.view(np.float64).flat
        for lane in range(_LANES):
            row = rows[min(k + lane, end - 1, len(rows) - 1)].flat
            for element in range(vectors.size):
                numbers[element * _LANES + lane] = row[element]


@_copied
def _scatter(vectors: Any, k: int, end: int, rows: FloatArray) -> None:
    """The reverse of `_gather`."""
    numbers = vectors.view(np.float64).flat
    for lane in range(_LANES):
        row = rows[min(k + lane, end - 1)].flat
        for element in range(vectors.size):
            row[element] = numbers[element * _LANES + lane]


# --- all pedestrians of a range ---------------------------------------------------------------------------------------


@_inlined
def _of(array: FloatArray, k: int) -> FloatArray:
    """Row of pedestrian k; the only one if all share it."""
    return array[min(k, len(array) - 1)]


@_compiled
def _mix_all(
    begin: int,
    end: int,
    mean: FloatArray,
    cov: FloatArray,
    mode_prob: FloatArray,
    transition_prob: FloatArray,
    mixed_mean: FloatArray,
    mixed_cov: FloatArray,
    predicted: FloatArray,
) -> None:
    n = mean.shape[-1]
    weight = np.empty(mode_prob.shape[-1])
    for k in range(begin, end):
        x, P, mu, p = _of(mean, k), _of(cov, k), _of(mode_prob, k), _of(transition_prob, k)
        _mix_one(x, P, mu, p, mixed_mean[k], mixed_cov[k], predicted[k], weight, n, mean.shape[-2])


@_compiled
def _predict_all(
    begin: int,
    end: int,
    mean: FloatArray,
    cov: FloatArray,
    F: FloatArray,
    Q: FloatArray,
    predicted_mean: FloatArray,
    predicted_cov: FloatArray,
) -> None:
    n = mean.shape[-1]
    row = np.empty(n)
    for k in range(begin, end):
        x, P = _of(mean, k), _of(cov, k)
        _predict_one(x, P, _of(F, k), _of(Q, k), predicted_mean[k], predicted_cov[k], row, n)


@_compiled
def _update_all(
    begin: int,
    end: int,
    mean: FloatArray,
    cov: FloatArray,
    z: FloatArray,
    H: FloatArray,
    R: FloatArray,
    updated_mean: FloatArray,
    updated_cov: FloatArray,
    log_likelihood: FloatArray,
    nis: FloatArray,
) -> None:
    n, d = mean.shape[-1], z.shape[-1]
    scratch = np.empty(d), np.empty((d, n)), np.empty((d, d)), np.empty((n, d)), np.empty((n, n)), np.empty(max(n, d))
    for k in range(begin, end):
        x, P, y, R_ = _of(mean, k), _of(cov, k), _of(z, k), _of(R, k)
        _update_one(x, P, y, _of(H, k), R_, updated_mean[k], updated_cov[k], log_likelihood[k], nis[k], scratch, n, d)


@_compiled
def _update_mode_prob_all(
    begin: int, end: int, predicted: FloatArray, log_likelihood: FloatArray, mode_prob: FloatArray
) -> None:
    for k in range(begin, end):
        _update_mode_prob_one(_of(predicted, k), _of(log_likelihood, k), mode_prob[k])


@_compiled
def _combine_all(
    begin: int, end: int, mean: FloatArray, cov: FloatArray, mode_prob: FloatArray, x: FloatArray, P: FloatArray
) -> None:
    n = mean.shape[-1]
    for k in range(begin, end):
        _moments(_of(mean, k), _of(cov, k), _of(mode_prob, k), x[k], P[k], n, mean.shape[-2])


@_compiled
def _cycle_usual(begin: int, end: int, *arrays: FloatArray) -> None:
    _cycles(begin, end, arrays, 4, 2, 6)


@_compiled
def _cycle_any(begin: int, end: int, *arrays: FloatArray) -> None:
    _cycles(begin, end, arrays, arrays[0].shape[-1], arrays[6].shape[-1], arrays[2].shape[-1])


@_copied
def _cycles(begin: int, end: int, arrays: tuple[FloatArray, ...], n: int, d: int, M: int) -> None:
    mean, cov, mode_prob, transition_prob, F, Q, z, H, R = arrays[:9]
    updated_mean, updated_cov, updated_mode_prob, combined_mean, combined_cov, nis = arrays[9:]
    given = (M, n), (M, n, n), (M,), (M, M), (M, n, n), (M, n, n), (d,), (d, n), (d, d)
    found = (M, n), (M, n, n), (M,), (n,), (n, n), (M,)
    between = (M, n), (M, n, n), (M,), (M,), (M,), (n,)
    # One room for the mixed estimates and, when nobody needs these any more, the updated ones.
    room = _vectors(given + found + between + ((d,), (d, n), (d, d), (n, d), (n, n), (max(n, d),)))
    x, P, mu, p, F_, Q_, y, H_, R_ = room[:9]
    new_x, new_P, new_mu, combined_x, combined_P, distance = room[9:15]
    predicted_x, predicted_P, predicted_mu, log_likelihood, weight, row = room[15:21]
    for k in range(begin, end, _LANES):
        _gather(mean, k, begin, end, x)
        _gather(cov, k, begin, end, P)
        _gather(mode_prob, k, begin, end, mu)
        _gather(transition_prob, k, begin, end, p)
        _gather(F, k, begin, end, F_)
        _gather(Q, k, begin, end, Q_)
        _gather(z, k, begin, end, y)
        _gather(H, k, begin, end, H_)
        _gather(R, k, begin, end, R_)
        _mix_one(x, P, mu, p, new_x, new_P, predicted_mu, weight, n, M)
        _predict_one(new_x, new_P, F_, Q_, predicted_x, predicted_P, row, n)
        _update_one(predicted_x, predicted_P, y, H_, R_, new_x, new_P, log_likelihood, distance, room[21:], n, d)
        for lane in range(_LANES):
            prior, evidence = predicted_mu.view(np.float64)[lane::_LANES], log_likelihood.view(np.float64)[lane::_LANES]
            _update_mode_prob_one(prior, evidence, new_mu.view(np.float64)[lane::_LANES])
        _moments(new_x, new_P, new_mu, combined_x, combined_P, n, M)
        _scatter(new_x, k, end, updated_mean)
        _scatter(new_P, k, end, updated_cov)
        _scatter(new_mu, k, end, updated_mode_prob)
        _scatter(combined_x, k, end, combined_mean)
        _scatter(combined_P, k, end, combined_cov)
        _scatter(distance, k, end, nis)


# --- one pedestrian ---------------------------------------------------------------------------------------------------


@_inlined
def _mix_one(
    mean: FloatArray,
    cov: FloatArray,
    mode_prob: FloatArray,
    transition_prob: FloatArray,
    mixed_mean: FloatArray,
    mixed_cov: FloatArray,
    predicted: FloatArray,
    weight: FloatArray,
    n: int,
    M: int,
) -> None:
    for j in range(M):
        total = 0.0
        for i in range(M):
            weight[i] = transition_prob[i, j] * mode_prob[i]
            total += weight[i]
        predicted[j] = total
        for i in range(M):
            weight[i] = _if_positive(total, weight[i] / total, 1.0 if i == j else 0.0)
        _moments(mean, cov, weight, mixed_mean[j], mixed_cov[j], n, M)


@_inlined
def _moments(
    mean: FloatArray, cov: FloatArray, weight: FloatArray, x: FloatArray, P: FloatArray, n: int, M: int
) -> None:
    """Mean and covariance of a mixture: x = sum w_i x_i;  P = sum w_i (P_i + (x_i - x)(x_i - x)')."""
    for a in range(n):
        total = 0.0
        for i in range(M):
            total += weight[i] * mean[i, a]
        x[a] = total
    for a in range(n):
        for b in range(a, n):
            total = 0.0
            for i in range(M):
                total += weight[i] * (cov[i, a, b] + (mean[i, a] - x[a]) * (mean[i, b] - x[b]))
            P[a, b] = total
            P[b, a] = total


@_inlined
def _predict_one(
    mean: FloatArray,
    cov: FloatArray,
    F: FloatArray,
    Q: FloatArray,
    predicted_mean: FloatArray,
    predicted_cov: FloatArray,
    row: FloatArray,
    n: int,
) -> None:
    for j in range(len(mean)):
        for a in range(n):
            total = 0.0
            for b in range(n):
                total += F[j, a, b] * mean[j, b]
                predicted_cov[j, a, b] = Q[j, a, b]
            predicted_mean[j, a] = total
        _add_sandwich(F[j], cov[j], predicted_cov[j], row, n, n)


@_inlined
def _add_sandwich(A: FloatArray, B: FloatArray, total: FloatArray, row: FloatArray, n: int, m: int) -> None:
    """Add A B A' to a symmetric matrix (n, n); A (n, m), B symmetric (m, m)."""
    for a in range(n):
        for b in range(m):
            element = 0.0
            for c in range(m):
                element += A[a, c] * B[c, b]
            row[b] = element
        for b in range(a, n):
            element = total[a, b]
            for c in range(m):
                element += row[c] * A[b, c]
            total[a, b] = element
            total[b, a] = element


@_inlined
def _update_one(
    mean: FloatArray,
    cov: FloatArray,
    z: FloatArray,
    H: FloatArray,
    R: FloatArray,
    updated_mean: FloatArray,
    updated_cov: FloatArray,
    log_likelihood: FloatArray,
    nis: FloatArray,
    scratch: tuple[FloatArray, ...],
    n: int,
    d: int,
) -> None:
    y, HP, S, K, I_KH, row = scratch  # (d,), (d, n), (d, d), (n, d), (n, n), (max(n, d),)
    for j in range(len(mean)):
        for r in range(d):
            element = z[r]
            for a in range(n):
                element -= H[r, a] * mean[j, a]
            y[r] = element
            for a in range(n):
                element = 0.0
                for b in range(n):
                    element += H[r, b] * cov[j, a, b]
                HP[r, a] = element
            for s in range(d):
                element = R[r, s]
                for a in range(n):
                    element += HP[r, a] * H[s, a]
                S[r, s] = element
        log_det_S = _invert(S, d)
        distance = 0.0
        for r in range(d):
            for s in range(d):
                distance += y[r] * S[r, s] * y[s]
        nis[j] = distance
        log_likelihood[j] = -0.5 * (distance + log_det_S + d * _LOG_2_PI)
        for a in range(n):
            corrected = mean[j, a]
            for r in range(d):
                element = 0.0
                for s in range(d):
                    element += HP[s, a] * S[s, r]
                K[a, r] = element
                corrected += element * y[r]
            updated_mean[j, a] = corrected
            for b in range(n):
                element = 1.0 if a == b else 0.0
                for r in range(d):
                    element -= K[a, r] * H[r, b]
                I_KH[a, b] = element
                updated_cov[j, a, b] = 0.0
        _add_sandwich(I_KH, cov[j], updated_cov[j], row, n, n)
        _add_sandwich(K, R, updated_cov[j], row, n, d)


@_inlined
def _invert(S: FloatArray, d: int) -> float:
    """Log determinant of S (d, d), which becomes its inverse, by Gauss and Jordan; a covariance needs no pivoting."""
    det = 1.0
    for k in range(d):
        pivot = S[k, k]
        det *= pivot
        S[k, k] = 1.0
        for s in range(d):
            S[k, s] /= pivot
        for r in range(d):
            if r != k:
                factor = S[r, k]
                S[r, k] = 0.0
                for s in range(d):
                    S[r, s] -= factor * S[k, s]
    return math.log(det)


@_inlined
def _update_mode_prob_one(predicted: FloatArray, log_likelihood: FloatArray, mode_prob: FloatArray) -> None:
    M = len(predicted)
    highest = -np.inf
    for j in range(M):
        mode_prob[j] = np.log(predicted[j]) + log_likelihood[j]
        if mode_prob[j] > highest or np.isnan(mode_prob[j]):
            highest = mode_prob[j]  # NaN, once found, stays: nothing is larger
    if not np.isfinite(highest):
        mode_prob[:] = predicted
        return
    total = 0.0
    for j in range(M):
        mode_prob[j] = math.exp(mode_prob[j] - highest)
        total += mode_prob[j]
    for j in range(M):
        mode_prob[j] /= total
