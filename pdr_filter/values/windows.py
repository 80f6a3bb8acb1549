"""Context windows: the classification of one window, and all windows of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pdr_filter.values.arrays import FloatArray, read_only, reduction
from pdr_filter.values.contexts import CARRYING_MODES, CONTEXTS
from pdr_filter.values.optional_packages import load_optional

_EVEN = read_only(np.full(len(CARRYING_MODES), 1 / len(CARRYING_MODES)))


@dataclass(frozen=True, eq=False)
class WindowContext:
    """Classification of one window, which describes the samples from `start_s` to `time_s`.

    Attributes
    ----------
    time_s : float
        End of the window, s.
    prob : FloatArray
        Probabilities of the contexts of the stage, shape (C,). The prior of the classifier has the weight
        `unknown_share` in them.
    training_prior : FloatArray
        Prior of the classifier, shape (C,).
    carrying_prob : FloatArray
        Probabilities of `CARRYING_MODES` after this window, shape (5,).
    unknown_share, stairs_unknown_share : float
        Dissimilarity to all training windows, and of window and place of the phone to stairs in training, 0 to 1.
    irregular_prob : float
        Probability of irregular motion: the phone is handled while the person does not walk.
    model : str
        Name of the context model.
    climb_rate_mps : float
        Climb rate from the barometer, up positive, m/s. NaN without barometer.
    has_gyroscope : bool
        True if the angular rate is known throughout the window.
    start_s, hop_s : float
        Time of the first sample of the window, and time between the ends of consecutive windows, s.
    is_unlike : bool
        True if the window is farther from all training windows than nine of ten windows of held-out people.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values import WindowContext
    >>> window = WindowContext(2.0, prob=np.array([0.1, 0.9]), training_prior=np.array([0.5, 0.5]))
    >>> window.new_since_s
    1.0
    """

    time_s: float
    prob: FloatArray
    training_prior: FloatArray
    carrying_prob: FloatArray = field(default_factory=lambda: _EVEN)
    unknown_share: float = 0.0
    stairs_unknown_share: float = 0.0
    irregular_prob: float = 0.0
    model: str = ""
    climb_rate_mps: float = np.nan
    has_gyroscope: bool = True
    start_s: float = np.nan
    hop_s: float = 1.0
    is_unlike: bool = False

    @property
    def new_since_s(self) -> float:
        """Start of the samples that are new in this window, s: one hop before its end."""
        return self.time_s - self.hop_s


def known_context(
    time_s: float, context: Mapping[str, float], carrying_mode: Mapping[str, float], contexts: Sequence[str], name: str
) -> WindowContext:
    """Return the result of a rule for the window that ends at `time_s`.

    Parameters
    ----------
    time_s : float
        End of the window.
    context : mapping
        Probability of each of the default contexts by name. Contexts that are not named have probability zero.
    carrying_mode : mapping
        Probability of each of `CARRYING_MODES` by name. All modes are equally probable if it is empty.
    contexts : sequence of str
        Contexts that the rule distinguishes. They are equally probable a priori.
    name : str
        Name of the rule, the `model` of the windows.

    Returns
    -------
    WindowContext
        Classification of the window.

    Examples
    --------
    >>> from pdr_filter.values import known_context
    >>> known_context(2.0, {"walking": 1.0}, {}, ["stationary", "walking"], "my rule").prob
    array([0., 1., 0., 0., 0., 0.])
    """
    prob = np.array([context.get(c, 0.0) for c in CONTEXTS])
    carrying = np.array([carrying_mode.get(c, 0.0) for c in CARRYING_MODES]) if carrying_mode else _EVEN
    prior = np.array([float(c in contexts) for c in CONTEXTS])
    return WindowContext(time_s, read_only(prob), read_only(prior / prior.sum()), read_only(carrying), model=name)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Windows:
    """Probabilities of contexts and carrying modes in all W windows of a recording.

    C is the number of contexts, and D the number of carrying modes.

    Attributes
    ----------
    time_s : ndarray, shape (W,)
        End of each window, s.
    context_prob, carrying_prob : ndarray, shape (W, C) and (W, D)
        Probability of each context, with the effect of `unknown_share`, and of each carrying mode, from this window and
        all earlier ones.
    contexts, carrying_modes : tuple of str
        Names of the contexts and of the carrying modes.
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

    __reduce__ = reduction

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
        return load_optional("pandas", "Windows.to_pandas").DataFrame(columns)

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
