"""Context windows of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pdr_filter.values.arrays import FloatArray, pickled


def pandas_module(method: str) -> Any:
    """Return the module pandas; ImportError that names the extra to install if it is missing."""
    try:
        import pandas  # pyright: ignore  (optional)
    except ImportError:
        raise ImportError(f'{method} needs pandas: pip install "pdr_filter[parquet]"') from None
    return pandas


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Windows:
    """Probabilities of contexts and carrying modes in all W windows of a recording.

    C is the number of contexts, and D the number of carrying modes.

    Attributes
    ----------
    time_s : ndarray, shape (W,)
        End of each window, s.
    context_prob : ndarray, shape (W, C)
        Probability of each context, including the effect of `unknown_share`.
    contexts : tuple of str
        Names of the contexts.
    carrying_prob : ndarray, shape (W, D)
        Probability of each carrying mode, from this window and all earlier ones.
    carrying_modes : tuple of str
        Names of the carrying modes.
    unknown_share : ndarray, shape (W,)
        Dissimilarity of the window to the training windows of the classifier, 0 to 1. `context_prob` already includes
        it.
    stairs_unknown_share : ndarray, shape (W,)
        0 if the training data contain stairs with similar signals and the same place of the phone, 1 if not. Where it
        is 1, the classifier cannot tell stairs from level walking.
    irregular_prob : ndarray, shape (W,)
        Probability that the phone moves without walking: it is taken out, turned, or put away.
    climb_rate_mps : ndarray, shape (W,)
        Climb rate from the barometer, m/s, up positive. NaN without barometer.
    model : tuple of str
        Name of the context model of each window.
    standing_contexts : tuple of str
        Names of the contexts without steps.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> windows = pdr.classify(pdr.simulate.demo_walk())
    >>> windows.context_prob.shape == (len(windows), len(windows.contexts))
    True
    """

    time_s: FloatArray
    context_prob: FloatArray
    contexts: tuple[str, ...]
    carrying_prob: FloatArray
    carrying_modes: tuple[str, ...]
    unknown_share: FloatArray
    stairs_unknown_share: FloatArray
    irregular_prob: FloatArray
    climb_rate_mps: FloatArray
    model: tuple[str, ...]
    standing_contexts: tuple[str, ...] = ("stationary",)

    __reduce__ = pickled

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame with one row per window; needs the extra `parquet`.

        Columns: `time_s`, `context_prob_NAME`, `carrying_prob_NAME`, `unknown_share`, `stairs_unknown_share`,
        `irregular_prob`, `climb_rate_mps` and `model`.

        Returns
        -------
        pandas.DataFrame
            One row for each window.
        """
        columns = {
            "time_s": self.time_s,
            **{f"context_prob_{name}": self.context_prob[:, i] for i, name in enumerate(self.contexts)},
            **{f"carrying_prob_{name}": self.carrying_prob[:, i] for i, name in enumerate(self.carrying_modes)},
            **{name: getattr(self, name) for name in ("unknown_share", "stairs_unknown_share")},
            **{name: getattr(self, name) for name in ("irregular_prob", "climb_rate_mps")},
            "model": list(self.model),
        }
        return pandas_module("Windows.to_pandas").DataFrame(columns)

    @property
    def standing_prob(self) -> FloatArray:
        """Probability (W,) that the pedestrian makes no steps in each window."""
        return self.context_prob[:, self.standing_index].sum(axis=1)

    @property
    def standing_index(self) -> list[int]:
        """Indices of the contexts without steps."""
        return [i for i, name in enumerate(self.contexts) if name in self.standing_contexts]

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"Windows({len(self)} windows)"
