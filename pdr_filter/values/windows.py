"""Context windows of a recording."""

from __future__ import annotations

from dataclasses import dataclass

from pdr_filter.values.arrays import FloatArray, pickled


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
        Dissimilarity of the window and the place of the phone to the stairs in the training data, 0 to 1.
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
